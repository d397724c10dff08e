//! A tap on the line between the drivers and the virtual units: every command as the unit hears it,
//! with its target in mm, and faults at commands of the test's choice. In this process, in bench
//! time: nothing sleeps.
//!
//! ```text
//! drivers -> bytes -> Line (tap: log, faults) -> ascii::parse, Unit | BinaryUnit -> bytes -> drivers
//! ```

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, ErrorKind};
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{
    Camera, Clocks, DeviceError, DeviceIdentity, Interrogator, Mount, Stage, StageReading,
};
use wcal_core::rig_devices::{CameraRig, DeviceOpener, InterrogatorRig, MountRig, StageRig};
use wcal_drivers::Drivers;
use wcal_drivers::bench::ascii;
use wcal_drivers::bench::axis::Axis;
use wcal_drivers::bench::binary::{BinaryUnit, Message};
use wcal_drivers::bench::in_process::InProcess;
use wcal_drivers::bench::plant::Plant;
use wcal_drivers::bench::scenario::{Scenario, StageProtocol};
use wcal_drivers::zaber::wire::ByteLink;

/// Time on the line of a command and of its reply, s: some 15 and 25 characters at 115,200 baud.
const ON_THE_LINE_S: f64 = 1.5e-3;

/// What a command asks of a unit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Order {
    /// To move to this position, mm of the unit's own scale; relative moves and those to an end are
    /// resolved.
    Move(f64),
    /// To search the reference: to 0 mm.
    Home,
    /// To stop.
    Stop,
    /// A question or a setting.
    Other,
}

/// A command as a unit heard it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Command {
    /// Bench time, s.
    pub t_s: f64,
    /// Unit: 1 the stage, 2 the mount. A command to all units is heard once by each.
    pub unit: u8,
    /// What it asks.
    pub order: Order,
    /// Where the stage is when it comes, mm.
    pub stage_mm: f64,
    /// Whether the stage moves when it comes.
    pub stage_moves: bool,
    /// The bytes, without the line end.
    pub bytes: Vec<u8>,
}

/// What goes wrong at a command.
pub(crate) enum TapFault {
    /// The motion of the stage that it begins, or that runs, stalls.
    Stall,
    /// Its reply comes after the driver has given it up, before that of the next command.
    LateReply,
    /// Its reply is lost.
    LoseReply,
    /// The port is gone, before the unit hears it; so many attempts to open it again fail.
    LosePort(usize),
    /// Something else: a signal, a panic.
    Do(Box<dyn FnOnce() + Send>),
}

#[derive(Default)]
struct State {
    commands: Vec<Command>,
    faults: BTreeMap<usize, TapFault>,
    /// Links that were opened; a lost port ends the newest.
    opened: usize,
    refusals: usize,
    /// The newest link is dead.
    dead: bool,
}

/// A bench whose stage line is tapped. Clones are the same one.
#[derive(Clone)]
pub(crate) struct Tap {
    bench: InProcess,
    state: Arc<Mutex<State>>,
    protocol: StageProtocol,
}

impl Tap {
    /// A bench by a scenario.
    pub(crate) fn new(scenario: Scenario, plant: Box<dyn Plant>) -> Self {
        let protocol = scenario.stage.protocol;
        Self {
            bench: InProcess::new(scenario, plant),
            state: Arc::default(),
            protocol,
        }
    }

    /// The drivers of this bench, for `record` or on their own. The port of the rig is not looked
    /// at.
    pub(crate) fn devices(&self, interrupt: &Interrupt) -> TapDevices {
        let tap = self.clone();
        let connect = Rc::new(move |_: &_, _: &_| tap.open());
        TapDevices {
            tap: self.clone(),
            drivers: Drivers::over(connect, interrupt),
        }
    }

    /// The pause of a sweep: bench time passes.
    pub(crate) fn pause(&self, time: Duration) {
        self.bench.pause(time);
    }

    /// Something goes wrong at the command of this number, counted from 0 from the first opening
    /// on.
    pub(crate) fn at(&self, command: usize, fault: TapFault) {
        self.state().faults.insert(command, fault);
    }

    /// Every command so far.
    pub(crate) fn commands(&self) -> Vec<Command> {
        self.state().commands.clone()
    }

    /// Whether stage or mount move now; bench time stands while nobody asks.
    pub(crate) fn is_moving(&self) -> bool {
        let t_s = self.bench.state().clock.now_s();
        let mut world = self.bench.state().world();
        world.units.iter_mut().any(|unit| {
            unit.axis.update(t_s);
            unit.axis.busy(t_s)
        })
    }

    /// Where the stage is, mm.
    pub(crate) fn stage_mm(&self) -> f64 {
        let t_s = self.bench.state().clock.now_s();
        self.bench.state().world().units[0].axis.at(t_s).0
    }

    /// `maxspeed` of a unit (index: 0 the stage), as the unit counts it.
    pub(crate) fn speed_data(&self, index: usize) -> i64 {
        let axis = &self.bench.state().world().units[index].axis;
        match self.protocol {
            StageProtocol::Ascii => axis.spec.unit.speed_data(axis.speed_mm_s),
            // 9.375 microsteps a second.
            StageProtocol::Binary => {
                (axis.speed_mm_s * 1e3 / axis.spec.unit.size_um / 9.375).round() as i64
            }
        }
    }

    /// The bench behind it.
    pub(crate) fn bench(&self) -> &InProcess {
        &self.bench
    }

    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        // A panic that a test injects leaves the log as it is.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn open(&self) -> io::Result<Box<dyn ByteLink>> {
        let mut state = self.state();
        if state.refusals > 0 {
            state.refusals -= 1;
            return Err(ErrorKind::NotFound.into());
        }
        state.opened += 1;
        state.dead = false;
        let spec = &self.bench.state().scenario.stage.unit;
        let face = BinaryUnit::new(1, spec.device_id, 513, spec.serial);
        let number = state.opened;
        Ok(Box::new(Line {
            tap: self.clone(),
            number,
            heard: Vec::new(),
            said: VecDeque::new(),
            late: Vec::new(),
            face,
        }))
    }

    /// Notes a command and carries out what goes wrong at it.
    fn note(&self, unit: u8, order: Order, bytes: &[u8]) -> Option<TapFault> {
        let t_s = self.bench.state().clock.now_s();
        let (stage_mm, stage_moves) = {
            let axis = &self.bench.state().world().units[0].axis;
            (axis.at(t_s).0, axis.busy(t_s))
        };
        let fault = {
            let mut state = self.state();
            let number = state.commands.len();
            let fault = state.faults.remove(&number);
            if let Some(TapFault::LosePort(refusals)) = fault {
                (state.dead, state.refusals) = (true, refusals);
                return Some(TapFault::LosePort(refusals));
            }
            let bytes = bytes.to_vec();
            state.commands.push(Command {
                t_s,
                unit,
                order,
                stage_mm,
                stage_moves,
                bytes,
            });
            fault
        };
        match fault {
            Some(TapFault::Stall) => {
                self.bench.state().world().units[0].axis.arm_stall();
                None
            }
            Some(TapFault::Do(what)) => {
                what();
                None
            }
            other => other,
        }
    }
}

/// One opened link.
struct Line {
    tap: Tap,
    number: usize,
    heard: Vec<u8>,
    said: VecDeque<u8>,
    late: Vec<u8>,
    face: BinaryUnit,
}

impl std::fmt::Debug for Line {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Line")
            .field("number", &self.number)
            .finish_non_exhaustive()
    }
}

/// Where a command drives an axis.
fn order_of(words: &[&str], axis: &Axis, t_s: f64) -> Order {
    let unit = axis.spec.unit;
    let end_mm = unit.to_mm(axis.spec.limit_steps as f64);
    let number = |text: &str| text.parse::<f64>().unwrap_or(f64::NAN);
    match words {
        ["home"] => Order::Home,
        ["stop" | "estop"] => Order::Stop,
        ["move", "abs", steps, ..] => Order::Move(unit.to_mm(number(steps))),
        ["move", "rel", steps, ..] => Order::Move(axis.at(t_s).0 + unit.to_mm(number(steps))),
        ["move", "vel", data, ..] if number(data) == 0.0 => Order::Stop,
        ["move", "vel", data, ..] => Order::Move(if number(data) > 0.0 { end_mm } else { 0.0 }),
        ["move", "min", ..] => Order::Move(0.0),
        ["move", "max", ..] => Order::Move(end_mm),
        // A word for a motion that the tap does not know must not pass for a question.
        ["move", ..] => Order::Move(f64::NAN),
        _ => Order::Other,
    }
}

fn binary_order(message: Message, axis: &Axis, t_s: f64) -> Order {
    let unit = axis.spec.unit;
    let data_mm = unit.to_mm(message.data.into());
    match message.command {
        1 => Order::Home,
        20 => Order::Move(data_mm),
        21 => Order::Move(axis.at(t_s).0 + data_mm),
        22 if message.data == 0 => Order::Stop,
        22 => Order::Move(if message.data > 0 {
            unit.to_mm(axis.spec.limit_steps as f64)
        } else {
            0.0
        }),
        // To a stored position.
        18 => Order::Move(f64::NAN),
        23 => Order::Stop,
        _ => Order::Other,
    }
}

impl Line {
    fn is_dead(&self) -> bool {
        let state = self.tap.state();
        state.dead && self.number == state.opened || self.number < state.opened
    }

    /// Executes what was heard; `false` when the port was lost over it.
    fn obey(&mut self) -> bool {
        match self.tap.protocol {
            StageProtocol::Ascii => self.obey_ascii(),
            StageProtocol::Binary => self.obey_binary(),
        }
    }

    fn obey_ascii(&mut self) -> bool {
        while let Some(end) = self.heard.iter().position(|b| *b == b'\n') {
            let line: Vec<u8> = self.heard.drain(..=end).collect();
            let line = &line[..end];
            let Some(command) = ascii::parse(line) else {
                continue;
            };
            let bench = self.tap.bench.clone();
            let t_s = bench.state().clock.now_s();
            let count = bench.state().world().units.len();
            for index in 0..count {
                let order = {
                    let world = bench.state().world();
                    let unit = &world.units[index];
                    if !unit.hears(&command, t_s) {
                        continue;
                    }
                    let words: Vec<&str> = command.words.iter().map(String::as_str).collect();
                    order_of(&words, &unit.axis, t_s)
                };
                let fault = self.tap.note(index as u8 + 1, order, line);
                if matches!(fault, Some(TapFault::LosePort(_))) {
                    return false;
                }
                let reply = bench.state().world().units[index]
                    .execute(&command, t_s)
                    .concat();
                self.say(reply.as_bytes(), fault.as_ref());
            }
        }
        true
    }

    fn obey_binary(&mut self) -> bool {
        while let Some((six, rest)) = self.heard.split_first_chunk::<6>() {
            let (six, rest) = (*six, rest.to_vec());
            self.heard = rest;
            let message = Message::from_bytes(six);
            let bench = self.tap.bench.clone();
            let t_s = bench.state().clock.now_s();
            let order = binary_order(message, &bench.state().world().units[0].axis, t_s);
            let fault = self.tap.note(1, order, &six);
            if matches!(fault, Some(TapFault::LosePort(_))) {
                return false;
            }
            let said = {
                let mut world = bench.state().world();
                self.face.execute(&mut world.units[0].axis, message, t_s)
            };
            if let Some(said) = said {
                self.say(&said.bytes(), fault.as_ref());
            }
        }
        true
    }

    fn say(&mut self, reply: &[u8], fault: Option<&TapFault>) {
        match fault {
            Some(TapFault::LoseReply) => {}
            Some(TapFault::LateReply) => self.late.extend(reply),
            _ => self.said.extend(reply),
        }
    }
}

impl ByteLink for Line {
    fn send(&mut self, bytes: &[u8], _: &Deadline) -> io::Result<usize> {
        if self.is_dead() {
            return Err(ErrorKind::BrokenPipe.into());
        }
        self.tap.bench.pass(ON_THE_LINE_S);
        // What was late arrives now.
        self.said.extend(self.late.drain(..));
        self.heard.extend(bytes);
        match self.obey() {
            true => Ok(bytes.len()),
            false => Err(ErrorKind::BrokenPipe.into()),
        }
    }

    fn receive(&mut self, into: &mut [u8], deadline: &Deadline) -> io::Result<usize> {
        if self.is_dead() {
            return Err(ErrorKind::BrokenPipe.into());
        }
        if self.tap.protocol == StageProtocol::Binary {
            let t_s = self.tap.bench.state().clock.now_s();
            let ended = self
                .face
                .update(&mut self.tap.bench.state().world().units[0].axis, t_s);
            self.said.extend(ended.into_iter().flat_map(Message::bytes));
        }
        if self.said.is_empty() {
            // Nobody waits: the time that was allowed passes.
            self.tap.bench.pass(deadline.remaining().as_secs_f64());
            return Err(ErrorKind::TimedOut.into());
        }
        self.tap.bench.pass(ON_THE_LINE_S);
        let count = into.len().min(self.said.len());
        for (slot, byte) in into.iter_mut().zip(self.said.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }

    fn pause(&mut self, pause: Duration, _: &Deadline) {
        self.tap.bench.pass(pause.as_secs_f64());
    }
}

/// The devices of a tapped bench.
pub(crate) struct TapDevices {
    tap: Tap,
    drivers: Drivers,
}

impl DeviceOpener for TapDevices {
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        let stage = self.drivers.stage(rig, clock)?;
        Ok(Box::new(InBenchTime {
            stage,
            tap: self.tap.clone(),
        }))
    }

    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        self.drivers.mount(rig, clock)
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        self.tap.bench.clone().interrogator(rig, clock)
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        self.tap.bench.clone().camera(rig, clock)
    }

    fn repeats(&self) -> u64 {
        self.drivers.repeats()
    }
}

/// A stage whose readings bear the bench's time: the host's clock runs on while the bench's stands.
struct InBenchTime {
    stage: Box<dyn Stage>,
    tap: Tap,
}

impl Stage for InBenchTime {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let identity = self.stage.identity()?;
        Ok(DeviceIdentity {
            model: format!("virtual {}", identity.model),
            ..identity
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        self.stage.travel_mm()
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        self.stage.start_home()
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        self.stage.start_move(target_mm, speed_mm_s)
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        let reading = self.stage.read()?;
        let clock = &self.tap.bench.state().clock;
        let clocks = Clocks {
            host_s: clock.epoch_s(clock.now_s()),
            ..reading.clocks
        };
        Ok(StageReading { clocks, ..reading })
    }

    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        self.stage.clear_flags()
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stage.stop()
    }
}
