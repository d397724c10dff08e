//! Stands in where libmujoco was not there when this program was built.

use wcal_mujoco::engine::protocol::{Reply, Request};

#[derive(Default)]
pub struct World {}

impl World {
    pub fn answer(&mut self, _: &Request) -> Reply {
        Reply::Refused {
            why: "wcal-mujoco was built without libmujoco 3.17.0; `make setup` fetches it, then build again"
                .to_owned(),
        }
    }
}
