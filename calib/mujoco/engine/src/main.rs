//! `wcal-mujoco`: MuJoCo and CoACD behind lines of JSON on stdin and stdout
//! (wcal_mujoco::engine::protocol).

mod convex;
mod native;
#[cfg(mujoco)]
mod world;
#[cfg(not(mujoco))]
#[path = "without.rs"]
mod world;

use std::io::{BufRead, Write};
use wcal_mujoco::engine::protocol::{Reply, Request};

fn main() -> std::io::Result<()> {
    let refused = native::loaded().err();
    if refused.is_none() {
        native::quiet();
    }
    let mut world = world::World::default();
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let request = serde_json::from_str::<Request>(&line?);
        let reply = match request {
            _ if refused.is_some() => Reply::Refused {
                why: refused.clone().unwrap_or_default(),
            },
            Ok(Request::Decompose(surface)) => convex::parts(&surface),
            Ok(request) => world.answer(&request),
            Err(e) => Reply::Refused {
                why: format!("expected a request, found {e}"),
            },
        };
        serde_json::to_writer(&mut out, &reply)?;
        out.write_all(b"\n")?;
        out.flush()?;
    }
    Ok(())
}
