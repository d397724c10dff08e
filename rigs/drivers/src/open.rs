//! Opens the devices that a rig names.

use crate::cameras::{FolderCamera, NetCamera, V4l2Camera, V4l2Settings};
use crate::hyperion::Hyperion;
use crate::sm130::Sm130;
use crate::zaber::units::Microsteps;
use crate::zaber::wire::{Connect, connect};
use crate::zaber::{
    BinaryLine, Chain, Port, ZaberBinary, ZaberMount, ZaberStage, binary, check_travel,
};
use std::cell::RefCell;
use std::path::Path;
use std::rc::Rc;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind, Interrogator, Mount, Stage};
use wcal_core::rig_devices::{
    CameraDriver, CameraRig, DeviceOpener, InterrogatorDriver, InterrogatorRig, MountRig,
    StageDriver, StageRig,
};

/// Speeds of the factory: X-series, T-series.
const ASCII_BAUD: u32 = 115_200;
const BINARY_BAUD: u32 = 9600;

/// The drivers of this crate by their names. Dropped, they leave the units with the speeds that
/// they found.
pub struct Drivers {
    /// The line of an ASCII stage; a mount may be connected to it, too.
    chain: Option<Rc<RefCell<Chain>>>,
    /// The line of a binary stage.
    line: Option<Rc<RefCell<BinaryLine>>>,
    connect: Connect,
    /// Ends every wait of the devices.
    interrupt: Interrupt,
}

impl Default for Drivers {
    fn default() -> Self {
        Self::new(&Interrupt::default())
    }
}

impl Drivers {
    /// Devices whose waits end when the user wants an end.
    pub fn new(interrupt: &Interrupt) -> Self {
        Self::over(Rc::new(connect), interrupt)
    }

    /// As [`Self::new`], with links of the caller's for the ports of stage and mount.
    pub fn over(connect: Connect, interrupt: &Interrupt) -> Self {
        Self {
            chain: None,
            line: None,
            connect,
            interrupt: interrupt.clone(),
        }
    }

    /// The chain of a rig; the second time the same one, on a new link.
    fn chain(&mut self, rig: &StageRig) -> Result<Rc<RefCell<Chain>>, DeviceError> {
        if let Some(chain) = &self.chain {
            chain.borrow_mut().reopen()?;
            return Ok(Rc::clone(chain));
        }
        let silent = |e| match probed(rig) {
            true => self.silent(e, &Port::Serial(rig.port.clone(), BINARY_BAUD), rig.address),
            false => e,
        };
        let chain = Rc::new(RefCell::new(self.open_chain(rig).map_err(silent)?));
        self.chain = Some(Rc::clone(&chain));
        Ok(chain)
    }

    /// The line of a binary rig; the second time the same one, on a new link.
    fn open_chain(&self, rig: &StageRig) -> Result<Chain, DeviceError> {
        if probed(rig) {
            return Chain::probe(&rig.port, rig.address, &self.interrupt, &self.connect)
                .map(|found| found.0);
        }
        Chain::open(&port(rig, ASCII_BAUD), &self.interrupt, &self.connect)
    }

    fn line(&mut self, rig: &StageRig) -> Result<Rc<RefCell<BinaryLine>>, DeviceError> {
        if let Some(line) = &self.line {
            line.borrow_mut().reopen()?;
            return Ok(Rc::clone(line));
        }
        let place = port(rig, BINARY_BAUD);
        let line = Rc::new(RefCell::new(BinaryLine::open(
            &place,
            rig.address,
            &self.interrupt,
            &self.connect,
        )?));
        self.line = Some(Rc::clone(&line));
        Ok(line)
    }

    /// A unit of a chain did not answer: which ones do, or one in the other protocol.
    fn absent(&self, why: DeviceError, device: &str, address: u8) -> DeviceError {
        let (DeviceErrorKind::Timeout, Some(chain)) = (why.kind, &self.chain) else {
            return why;
        };
        match chain.borrow_mut().units() {
            Ok(units) if units.is_empty() => {}
            Ok(units) => {
                return wrong(
                    device,
                    "a unit at the rig's address",
                    &no_unit(address, &units),
                );
            }
            Err(_) => return why,
        }
        let place = chain.borrow().place().clone();
        // A serial port opens once at a time.
        chain.borrow_mut().close();
        self.silent(why, &place, address)
    }

    /// Nothing answers in ASCII: perhaps in the binary protocol.
    fn silent(&self, why: DeviceError, place: &Port, address: u8) -> DeviceError {
        if let Err(ended) = self.interrupt.check("stage", "open") {
            return ended;
        }
        if why.kind == DeviceErrorKind::Timeout
            && binary::answers(place, address, &self.interrupt, &self.connect)
        {
            let found = format!(
                "a unit {address} that speaks the binary protocol: driver = \"zaber-binary\" under [stage], without a motorised mount"
            );
            return wrong("stage", "a unit that speaks the ASCII protocol", &found);
        }
        nobody(why)
    }

    /// Nothing answers in the binary protocol: perhaps in ASCII.
    fn not_binary(&self, why: DeviceError, rig: &StageRig) -> DeviceError {
        let (DeviceErrorKind::Timeout, Some(line)) = (why.kind, &self.line) else {
            return why;
        };
        let units = line.borrow_mut().units().unwrap_or_default();
        if !units.is_empty() {
            return wrong(
                "stage",
                "a unit at the rig's address",
                &no_unit(rig.address, &units),
            );
        }
        line.borrow_mut().close();
        match self.open_chain(rig).and_then(|mut chain| chain.units()) {
            Ok(units) if !units.is_empty() => {
                let found =
                    "a unit that speaks the ASCII protocol: driver = \"zaber-ascii\" under [stage]";
                wrong("stage", "a unit that speaks the binary protocol", found)
            }
            _ => nobody(why),
        }
    }
}

fn wrong(what: &str, expected: &str, found: &str) -> DeviceError {
    DeviceError::new(
        DeviceErrorKind::Configuration,
        what,
        "open",
        expected,
        found,
    )
}

fn no_unit(address: u8, there: &[u8]) -> String {
    let list: Vec<String> = there.iter().map(u8::to_string).collect();
    format!(
        "no unit at address {address} (units that answer: {})",
        list.join(", ")
    )
}

/// Silence in both protocols.
fn nobody(why: DeviceError) -> DeviceError {
    match why.kind {
        DeviceErrorKind::Timeout => {
            let found = format!(
                "{}; no unit answers in either protocol: power, cable, baud?",
                why.found
            );
            DeviceError { found, ..why }
        }
        _ => why,
    }
}

/// Whether the speed of the rig's port is not known.
fn probed(rig: &StageRig) -> bool {
    !rig.port.starts_with("tcp://") && rig.baud.is_none()
}

fn port(rig: &StageRig, default_baud: u32) -> Port {
    match rig.port.strip_prefix("tcp://") {
        Some(address) => Port::Tcp(address.to_owned()),
        None => Port::Serial(rig.port.clone(), rig.baud.unwrap_or(default_baud)),
    }
}

impl DeviceOpener for Drivers {
    /// Without a baud rate the line's speed is probed. Moves nothing.
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        let unit = Microsteps {
            size_um: rig.microstep_um,
        };
        // Who opens again wants to stop it, not to hear why it is silent.
        let first = self.chain.is_none() && self.line.is_none();
        let mut stage: Box<dyn Stage> = match rig.driver {
            StageDriver::ZaberAscii => {
                let stage = ZaberStage::new(self.chain(rig)?, rig.address, rig.axis, unit, clock);
                let why = |e| {
                    if first {
                        self.absent(e, "stage", rig.address)
                    } else {
                        e
                    }
                };
                Box::new(stage.map_err(why)?)
            }
            StageDriver::ZaberBinary => {
                let stage = ZaberBinary::new(self.line(rig)?, unit, clock);
                let why = |e| if first { self.not_binary(e, rig) } else { e };
                Box::new(stage.map_err(why)?)
            }
        };
        check_travel("stage", rig.travel_mm, stage.travel_mm()?[1])?;
        Ok(stage)
    }

    /// On the stage's line.
    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        let MountRig::Zaber { address, .. } = rig else {
            return Ok(None);
        };
        let Some(chain) = &self.chain else {
            return Err(wrong(
                "mount",
                "a stage with driver zaber-ascii, on whose line it is",
                "none",
            ));
        };
        let mount = ZaberMount::open(rig, Rc::clone(chain), clock, &self.interrupt);
        Ok(mount
            .map_err(|e| self.absent(e, "mount", *address))?
            .map(|m| Box::new(m) as Box<dyn Mount>))
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        match rig.driver {
            InterrogatorDriver::Sm130 => Ok(Box::new(Sm130::connect(
                &rig.address,
                rig.rate_hz,
                clock,
                &self.interrupt,
            )?)),
            InterrogatorDriver::Hyperion => {
                let peaks = rig.peaks_address.as_deref();
                let peaks = peaks.ok_or_else(|| wrong("interrogator", "peaks_address", "none"))?;
                let commands = &rig.address;
                Ok(Box::new(Hyperion::connect(
                    commands,
                    peaks,
                    rig.rate_hz,
                    clock,
                    &self.interrupt,
                )?))
            }
            InterrogatorDriver::Replay => Err(wrong("interrogator", "a device", "a recording")),
        }
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        let mut camera: Box<dyn Camera + Send> = match rig.driver {
            CameraDriver::Net => Box::new(NetCamera::connect(&rig.source, clock, &self.interrupt)?),
            CameraDriver::Folder => {
                let period_s = 1.0 / rig.rate_hz.unwrap_or(10.0);
                Box::new(FolderCamera::open(Path::new(&rig.source), period_s)?)
            }
            CameraDriver::V4l2 => {
                let settings = V4l2Settings {
                    size_px: rig.image_size_px,
                    rate_hz: rig.rate_hz,
                    controls: rig.controls.clone().into_iter().collect(),
                };
                Box::new(V4l2Camera::open(
                    &rig.source,
                    &settings,
                    clock,
                    &self.interrupt,
                )?)
            }
        };
        camera.configure(rig.exposure_ms, rig.gain_db)?;
        Ok(camera)
    }

    fn repeats(&self) -> u64 {
        let of_line = self.line.as_ref().map_or(0, |line| line.borrow().repeats());
        self.chain
            .as_ref()
            .map_or(of_line, |chain| chain.borrow().repeats())
    }
}
