//! A model and its state in MuJoCo.

use crate::native::{self, PLUGIN};
use mujoco_rs::prelude::*;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;
use std::sync::Once;
use wcal_mujoco::engine::fluid::FluidLoads;
use wcal_mujoco::engine::protocol::{Frame, LoadedModel, Reply, Request, Series, Touching};

/// What is loaded, and what is known of it.
#[derive(Default)]
pub struct World {
    loaded: Option<Model>,
}

struct Model {
    data: MjData<Box<MjModel>>,
    /// Body of each link, root first.
    links: Vec<usize>,
    /// Link of each geom that belongs to the wire, and the name of each geom.
    geoms: Vec<(Option<usize>, String)>,
    /// Joints and speeds of the hinges at the root.
    root: Option<[usize; 3]>,
    /// Position and speed of the slide `base`.
    base: Option<[usize; 2]>,
    /// Site of the torque sensor.
    sensor_site: Option<usize>,
    tip: Option<usize>,
    since: Since,
    /// Last places of the body that [`Request::Control`] watches, m.
    recent: VecDeque<Vector3<f64>>,
    bad: bool,
    /// What surrounds the wire, and the middles of its links at the step before, m.
    medium: Option<(FluidLoads, Vec<Vector3<f64>>)>,
}

/// Places of a watched body that are kept.
const RECENT: usize = 10;

/// Extremes since the last frame.
#[derive(Default)]
struct Since {
    steps: u64,
    deepest_m: f64,
    toggles: u64,
    touching: bool,
}

type Answer = Result<Reply, String>;

impl World {
    pub fn answer(&mut self, request: &Request) -> Reply {
        self.try_answer(request)
            .unwrap_or_else(|why| Reply::Refused { why })
    }

    fn try_answer(&mut self, request: &Request) -> Answer {
        if let Request::Hello = request {
            return Ok(Reply::Hello {
                mujoco: mujoco_rs::mujoco_version().to_owned(),
            });
        }
        if let Request::Load { xml, cable_plugin } = request {
            let model = Model::load(xml, *cable_plugin)?;
            let loaded = LoadedModel {
                freedoms: model.data.qvel().len(),
                step_s: model.data.model_opt().timestep,
            };
            self.loaded = Some(model);
            return Ok(Reply::LoadedModel(loaded));
        }
        let model = self
            .loaded
            .as_mut()
            .ok_or("expected a model to be loaded first")?;
        model.answer(request)
    }
}

impl Model {
    fn load(xml: &str, cable_plugin: bool) -> Result<Self, String> {
        if cable_plugin {
            load_cable_plugin()?;
        }
        let model =
            MjModel::from_xml_string(xml).map_err(|e| format!("MuJoCo refuses the model: {e}"))?;
        let id = |kind, name: &str| model.name_to_id(kind, name);
        // Our own layout names its links; MuJoCo's composite cable names them so.
        let own: Vec<usize> = (0..)
            .map_while(|j| id(MjtObjBase::mjOBJ_BODY, &format!("link{j}")))
            .collect();
        let links = if own.is_empty() {
            cable_links(&model)
        } else {
            own
        };
        let geoms = (0..model.geom_bodyid().len())
            .map(|g| {
                let body = model.geom_bodyid()[g] as usize;
                let name = model
                    .id_to_name(MjtObjBase::mjOBJ_GEOM, g)
                    .unwrap_or_default()
                    .to_owned();
                (links.iter().position(|b| *b == body), name)
            })
            .collect();
        let joint = |name: &str| id(MjtObjBase::mjOBJ_JOINT, name);
        let root = match (joint("joint0x"), joint("joint0y"), joint("joint0z")) {
            (Some(x), Some(y), Some(z)) => Some([x, y, z]),
            _ => None,
        };
        let base = joint("base").map(|j| {
            [
                model.jnt_qposadr()[j] as usize,
                model.jnt_dofadr()[j] as usize,
            ]
        });
        let sensor_site =
            id(MjtObjBase::mjOBJ_SENSOR, "torque").map(|s| model.sensor_objid()[s] as usize);
        let tip = ["tip", "wS_last"]
            .iter()
            .find_map(|name| id(MjtObjBase::mjOBJ_SITE, name));
        let mut data = MjData::new(Box::new(model));
        data.forward();
        Ok(Self {
            data,
            links,
            geoms,
            root,
            base,
            sensor_site,
            tip,
            since: Since::default(),
            recent: VecDeque::new(),
            bad: false,
            medium: None,
        })
    }

    fn answer(&mut self, request: &Request) -> Answer {
        match request {
            Request::Lead {
                speed_m_s,
                acceleration_m_s2,
                steps,
            } => {
                let [position, speed] = self.base.ok_or("expected a slide named base")?;
                let dt = self.data.model_opt().timestep;
                let start = self.data.qpos()[position];
                for k in 0..=*steps {
                    let t = k as f64 * dt;
                    // Both are set: the solver sees the speed, and what the contact does to the
                    // slide is undone.
                    self.data.qpos_mut()[position] =
                        start + (speed_m_s + 0.5 * acceleration_m_s2 * t) * t;
                    self.data.qvel_mut()[speed] = speed_m_s + acceleration_m_s2 * t;
                    if k < *steps {
                        self.step();
                    }
                }
            }
            Request::Control {
                control,
                retreat,
                goes_on,
                body,
                moved_m,
                steps,
            } => {
                let body = self.body(body)?;
                if !*goes_on {
                    self.recent.clear();
                }
                for _ in 0..*steps {
                    self.step();
                    if !retreat.is_empty() {
                        self.control(retreat)?;
                        (0..RECENT).for_each(|_| self.step());
                    }
                    self.control(control)?;
                    self.recent.push_back(Vector3::from(self.data.xpos()[body]));
                    if self.recent.len() > RECENT {
                        self.recent.pop_front();
                    }
                    let way = self
                        .recent
                        .front()
                        .zip(self.recent.back())
                        .map(|(a, b)| (b - a).norm());
                    if self.recent.len() == RECENT && way.is_some_and(|way| way < *moved_m) {
                        break;
                    }
                }
            }
            Request::Run { steps } => (0..*steps).for_each(|_| self.step()),
            Request::Push {
                body,
                along_m,
                force_n,
                steps,
            } => {
                let body = self.body(body)?;
                let force = Vector3::from(*force_n);
                for k in 0..*steps {
                    let share = (2.0 * (k + 1) as f64 / *steps as f64).min(1.0);
                    let turn = Matrix3::from_row_slice(&self.data.xmat()[body]);
                    let point = Vector3::from(self.data.xpos()[body]) + turn.column(0) * *along_m;
                    let mut applied = vec![0.0; self.data.qvel().len()];
                    self.data
                        .apply_ft(
                            &(force * share).into(),
                            &[0.0; 3],
                            &point.into(),
                            body,
                            &mut applied,
                        )
                        .map_err(|e| e.to_string())?;
                    self.data.qfrc_applied_mut().copy_from_slice(&applied);
                    self.step();
                }
                let frame = self.frame();
                self.data.qfrc_applied_mut().fill(0.0);
                return Ok(Reply::Frame(frame));
            }
            Request::Series { steps, every } => {
                return Ok(Reply::Series(self.series(*steps, (*every).max(1))));
            }
            Request::Medium { medium } => {
                if self.tip.is_none() {
                    return Err("expected a wire with its tip, found none".to_owned());
                }
                self.medium = Some((medium.clone(), self.middles()));
            }
            Request::Reset => {
                self.data.reset();
                self.data.forward();
                self.since = Since::default();
                self.recent.clear();
                let middles = self.middles();
                if let Some((_, before)) = &mut self.medium {
                    *before = middles;
                }
            }
            Request::Hello | Request::Load { .. } | Request::Decompose(_) => {
                return Err("asked elsewhere".to_owned());
            }
        }
        Ok(Reply::Frame(self.frame()))
    }

    fn control(&mut self, values: &[f64]) -> Result<(), String> {
        let at = self.data.ctrl_mut();
        if at.len() != values.len() {
            return Err(format!(
                "expected {} control values, found {}",
                at.len(),
                values.len()
            ));
        }
        at.copy_from_slice(values);
        Ok(())
    }

    fn body(&self, name: &str) -> Result<usize, String> {
        let found = self.data.model().name_to_id(MjtObjBase::mjOBJ_BODY, name);
        found.ok_or_else(|| format!("expected a body named {name:?}, found none"))
    }

    fn step(&mut self) {
        if let Some((medium, before)) = self.medium.take() {
            let middles = self.middles();
            self.push_by(&medium, &before, &middles);
            self.medium = Some((medium, middles));
        }
        self.data.step();
        self.since.steps += 1;
        let mut touching = false;
        for contact in self.data.contact() {
            touching |= contact.dist < 0.0;
            self.since.deepest_m = self.since.deepest_m.max(-contact.dist);
        }
        self.since.toggles += u64::from(touching != self.since.touching);
        self.since.touching = touching;
        self.bad |= WARNINGS
            .iter()
            .any(|w| self.data.warning()[*w as usize].number > 0);
    }

    /// Middles of the links, m.
    fn middles(&self) -> Vec<Vector3<f64>> {
        let mut ends: Vec<Vector3<f64>> = self
            .links
            .iter()
            .map(|b| Vector3::from(self.data.xpos()[*b]))
            .collect();
        ends.push(self.tip());
        ends.windows(2).map(|w| (w[0] + w[1]) / 2.0).collect()
    }

    /// The medium's forces on the links; drag of the step before's velocity.
    fn push_by(&mut self, medium: &FluidLoads, before: &[Vector3<f64>], now: &[Vector3<f64>]) {
        let dt = self.data.model_opt().timestep;
        for (&link, (was, is)) in self.links.iter().zip(before.iter().zip(now)) {
            let start = Vector3::from(self.data.xpos()[link]);
            let tangent = Matrix3::from_row_slice(&self.data.xmat()[link])
                .column(0)
                .into_owned();
            let length_mm = 2e3 * (is - start).norm();
            let force = medium.load_n_per_mm(&tangent, &((is - was) * (1e3 / dt))) * length_mm;
            self.data.xfrc_applied_mut()[link][..3].copy_from_slice(force.as_slice());
        }
    }

    fn series(&mut self, steps: u64, every: u64) -> Series {
        let mut series = Series::default();
        let mut before = self.tip();
        let dt = self.data.model_opt().timestep;
        for k in 1..=steps {
            self.step();
            let tip = self.tip();
            if k % every == 0 {
                series.time_s.push(self.data.time());
                series
                    .base_elastic_nm
                    .push(self.base_moment().map_or([0.0; 3], |m| m.1.into()));
                series.tip_speed_m_s.push((tip - before).norm() / dt);
                series.touching.push(self.since.touching);
            }
            before = tip;
        }
        series.bad = self.bad;
        series
    }

    fn tip(&self) -> Vector3<f64> {
        self.tip.map_or_else(Vector3::zeros, |site| {
            Vector3::from(self.data.site_xpos()[site])
        })
    }

    /// Moment that the first joint's springs and dampers carry: its components along the hinges'
    /// axes are their torques.
    fn base_moment(&self) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let joints = self.root?;
        let dof = joints.map(|j| self.data.model().jnt_dofadr()[j] as usize);
        let axes =
            Matrix3::from_rows(&joints.map(|j| Vector3::from(self.data.xaxis()[j]).transpose()));
        let inverse = axes.try_inverse()?;
        let spring = Vector3::from(dof.map(|d| self.data.qfrc_spring()[d]));
        let damper = Vector3::from(dof.map(|d| self.data.qfrc_damper()[d]));
        // The wire's load on the base is what springs and dampers hold it with, reversed.
        Some((-(inverse * (spring + damper)), -(inverse * spring)))
    }

    fn frame(&mut self) -> Frame {
        let moment = self.base_moment();
        let sensor_nm = self.sensor_site.and_then(|site| {
            let turn = Matrix3::from_row_slice(&self.data.site_xmat()[site]);
            Some((turn * Vector3::from_column_slice(self.data.sensordata().get(..3)?)).into())
        });
        let fastest = self.data.qvel().iter().map(|v| v.abs()).fold(0.0, f64::max);
        let since = std::mem::take(&mut self.since);
        self.since.touching = since.touching;
        let finite = self.data.qpos().iter().all(|x| x.is_finite());
        let mut links_m: Vec<[f64; 3]> = self.links.iter().map(|b| self.data.xpos()[*b]).collect();
        links_m.extend(self.tip.map(|site| self.data.site_xpos()[site]));
        Frame {
            time_s: self.data.time(),
            steps: since.steps,
            base_moment_nm: moment.map(|m| m.0.into()),
            base_elastic_nm: moment.map(|m| m.1.into()),
            sensor_nm,
            contacts: self.contacts(),
            fastest,
            deepest_m: since.deepest_m,
            toggles: since.toggles,
            bad: self.bad || !finite,
            core_s: core_s(),
            links_m,
        }
    }

    fn contacts(&self) -> Vec<Touching> {
        let mut all = Vec::new();
        for (k, contact) in self.data.contact().iter().enumerate() {
            let [a, b] = contact.geom.map(|g| g as usize);
            // MuJoCo's normal points from the first geom to the second, its force acts on the
            // second.
            let (wire, other, sign) = match (self.geoms[a].0, self.geoms[b].0) {
                (None, Some(link)) => (link, a, 1.0),
                (Some(link), None) => (link, b, -1.0),
                _ => continue,
            };
            let frame = Matrix3::from_row_slice(&contact.frame);
            let local = self.data.contact_force(k);
            let force = frame.transpose() * Vector3::new(local[0], local[1], local[2]);
            all.push(Touching {
                link: wire,
                other: self.geoms[other].1.clone(),
                point_m: contact.pos,
                gap_m: contact.dist,
                normal: (frame.row(0).transpose() * sign).into(),
                force_n: (force * sign).into(),
            });
        }
        all
    }
}

/// MuJoCo's own signs of a step gone wrong.
const WARNINGS: [MjtWarning; 3] = [
    MjtWarning::mjWARN_BADQPOS,
    MjtWarning::mjWARN_BADQVEL,
    MjtWarning::mjWARN_BADQACC,
];

/// Bodies of MuJoCo's composite cable, root first.
fn cable_links(model: &MjModel) -> Vec<usize> {
    let id = |name: String| model.name_to_id(MjtObjBase::mjOBJ_BODY, &name);
    let middle = (1..).map_while(|j| id(format!("wB_{j}")));
    id("wB_first".to_owned())
        .into_iter()
        .chain(middle)
        .chain(id("wB_last".to_owned()))
        .collect()
}

/// A plugin that does not load ends the process: its file is searched first.
fn load_cable_plugin() -> Result<(), String> {
    static ONCE: Once = Once::new();
    let path = native::checked(PLUGIN).map_err(|why| format!("MuJoCo's cable plugin: {why}"))?;
    let mut result = Ok(());
    ONCE.call_once(|| result = load_plugin_library(&path).map_err(|e| e.to_string()));
    result
}

/// Processor time of this program, s.
fn core_s() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
