//! Opens stage and mount on their line, and says who answers where they do not.

use super::axis::check_travel;
use super::binary::ZaberBinary;
use super::binary_line::BinaryLine;
use super::chain::Chain;
use super::mount::ZaberMount;
use super::stage::ZaberStage;
use super::units::Microsteps;
use super::wire::{Asks, Connect, Port};
use std::cell::RefCell;
use std::rc::Rc;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{DeviceError, DeviceErrorKind, Mount, Stage};
use wcal_core::rig_devices::{MountRig, StageDriver, StageRig};

/// Speeds of the factory: X-series, T-series.
const ASCII_BAUD: u32 = 115_200;
const BINARY_BAUD: u32 = 9600;

/// The lines of a rig's units. Dropped, they leave the units with the speeds that they found.
pub(crate) struct ZaberLines {
    /// The line of an ASCII stage; a mount may be connected to it, too.
    chain: Option<Rc<RefCell<Chain>>>,
    /// The line of a binary stage.
    line: Option<Rc<RefCell<BinaryLine>>>,
    connect: Connect,
    interrupt: Interrupt,
}

/// The line of a rig; the second time the same one, on a new link.
fn reopened<L: Asks>(
    line: &mut Option<Rc<RefCell<L>>>,
    open: impl FnOnce() -> Result<L, DeviceError>,
) -> Result<Rc<RefCell<L>>, DeviceError> {
    match line {
        // All units of the line share it: the mount goes on over the stage's new link.
        Some(line) => line.borrow_mut().wire().reopen()?,
        None => *line = Some(Rc::new(RefCell::new(open()?))),
    }
    line.clone().ok_or_else(|| wrong("stage", "a line", "none"))
}

impl ZaberLines {
    pub(crate) fn new(connect: Connect, interrupt: &Interrupt) -> Self {
        Self {
            chain: None,
            line: None,
            connect,
            interrupt: interrupt.clone(),
        }
    }

    /// The stage. Without a baud rate the line's speed is probed.
    pub(crate) fn stage(
        &mut self,
        rig: &StageRig,
        clock: HostClock,
    ) -> Result<Box<dyn Stage>, DeviceError> {
        // Who opens again wants to stop it, not to hear why it is silent.
        let first = self.chain.is_none() && self.line.is_none();
        let opened = self.try_stage(rig, clock);
        let mut stage = opened.map_err(|e| if first { self.silent(e, rig) } else { e })?;
        // The protocol does not report the microstep's size: a travel that fits shows that it is
        // right.
        check_travel("stage", rig.travel_mm, stage.travel_mm()?[1])?;
        Ok(stage)
    }

    fn try_stage(
        &mut self,
        rig: &StageRig,
        clock: HostClock,
    ) -> Result<Box<dyn Stage>, DeviceError> {
        let (connect, interrupt) = (&self.connect, &self.interrupt);
        let unit = Microsteps {
            size_um: rig.microstep_um,
        };
        Ok(match rig.driver {
            StageDriver::ZaberAscii => {
                let chain = reopened(&mut self.chain, || open_chain(rig, interrupt, connect))?;
                Box::new(ZaberStage::new(chain, rig.address, rig.axis, unit, clock)?)
            }
            StageDriver::ZaberBinary => {
                let place = port(rig, BINARY_BAUD);
                let open = || BinaryLine::open(&place, rig.address, interrupt, connect);
                Box::new(ZaberBinary::new(
                    reopened(&mut self.line, open)?,
                    unit,
                    clock,
                )?)
            }
        })
    }

    /// A mount, on the stage's line.
    pub(crate) fn mount(
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
        let mount = mount.map_err(|e| self.others(&e, "mount", *address).unwrap_or(e))?;
        Ok(mount.map(|mount| Box::new(mount) as Box<dyn Mount>))
    }

    /// Questions that had to be repeated.
    pub(crate) fn repeats(&self) -> u64 {
        let of_chain = self.chain.as_ref().map(|c| c.borrow().repeats());
        let of_line = self.line.as_ref().map(|l| l.borrow_mut().wire().repeats);
        of_chain.or(of_line).unwrap_or(0)
    }

    /// A unit did not answer: those that do.
    fn others(&self, why: &DeviceError, device: &str, address: u8) -> Option<DeviceError> {
        if why.kind != DeviceErrorKind::Timeout {
            return None;
        }
        let of_chain = self.chain.as_ref().map(|c| c.borrow_mut().units());
        let of_line = || self.line.as_ref().map(|l| l.borrow_mut().units());
        let units = of_chain.or_else(of_line)?.unwrap_or_default();
        let list: Vec<String> = units.iter().map(u8::to_string).collect();
        let found = format!(
            "no unit at address {address} (units that answer: {})",
            list.join(", ")
        );
        (!list.is_empty()).then(|| wrong(device, "a unit at the rig's address", &found))
    }

    /// Why the stage did not answer: others do, it speaks the other protocol, or nobody is there.
    fn silent(&self, why: DeviceError, rig: &StageRig) -> DeviceError {
        if let Some(others) = self.others(&why, "stage", rig.address) {
            return others;
        }
        if why.kind != DeviceErrorKind::Timeout {
            return why;
        }
        if let Err(ended) = self.interrupt.check("stage", "open") {
            return ended;
        }
        // A serial port opens once at a time.
        if let Some(chain) = &self.chain {
            chain.borrow_mut().wire().close();
        }
        if let Some(line) = &self.line {
            line.borrow_mut().wire().close();
        }
        let (address, connect) = (rig.address, &self.connect);
        match rig.driver {
            // A T-series unit is silent to ASCII: the message can say so in place of a timeout.
            StageDriver::ZaberAscii => {
                let place = port(rig, BINARY_BAUD);
                let line = BinaryLine::open(&place, address, &self.interrupt, connect);
                if line.is_ok_and(|mut line| line.answers()) {
                    let found = format!(
                        "a unit {address} that speaks the binary protocol: driver = \"zaber-binary\" under [stage], without a motorised mount"
                    );
                    return wrong("stage", "a unit that speaks the ASCII protocol", &found);
                }
            }
            StageDriver::ZaberBinary => {
                let chain = open_chain(rig, &self.interrupt, connect);
                let units = chain.and_then(|mut chain| chain.units());
                if units.is_ok_and(|units| !units.is_empty()) {
                    let found = "a unit that speaks the ASCII protocol: driver = \"zaber-ascii\" under [stage]";
                    return wrong("stage", "a unit that speaks the binary protocol", found);
                }
            }
        }
        DeviceError {
            found: format!(
                "{}; no unit answers in either protocol: power, cable, baud?",
                why.found
            ),
            ..why
        }
    }
}

/// The chain of a rig; without a baud rate at the speed at which it answers.
fn open_chain(
    rig: &StageRig,
    interrupt: &Interrupt,
    connect: &Connect,
) -> Result<Chain, DeviceError> {
    match port(rig, ASCII_BAUD) {
        // A port on TCP has no speed of the line to look for.
        Port::Serial(path, _) if rig.baud.is_none() => {
            Chain::probe(&path, rig.address, interrupt, connect).map(|(chain, _)| chain)
        }
        place => Chain::open(&place, interrupt, connect),
    }
}

fn port(rig: &StageRig, default_baud: u32) -> Port {
    match rig.port.strip_prefix("tcp://") {
        Some(address) => Port::Tcp(address.to_owned()),
        None => Port::Serial(rig.port.clone(), rig.baud.unwrap_or(default_baud)),
    }
}

fn wrong(device: &str, expected: &str, found: &str) -> DeviceError {
    DeviceError::new(
        DeviceErrorKind::Configuration,
        device,
        "open",
        expected,
        found,
    )
}
