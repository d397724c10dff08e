//! The virtual bench: stage, interrogators and cameras with the devices' own protocols, driven by
//! one plant.
//!
//! The program under test is connected to it only through sockets and a pseudo-terminal.

pub mod ascii;
pub mod axis;
pub mod binary;
mod camera_server;
mod clock;
pub mod faults;
mod hyperion_server;
pub mod in_process;
mod link;
mod lock;
mod motion;
pub mod plant;
pub mod scenario;
pub mod scene;
mod sm130_server;
mod stage_server;
pub mod unit;
mod unit_clock;
mod world;

use clock::BenchClock;
use faults::{Fault, FaultState};
use link::Pty;
use lock::guard;
use plant::Plant;
use scenario::Scenario;
use schemars::JsonSchema;
use serde::Serialize;
use serialport::{SerialPort, TTYPort};
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::thread::{JoinHandle, Scope};
use std::time::Duration;
use wcal_core::clock::late_s;
use wcal_core::shared_time;
use world::BenchState;

/// Where the devices answer; printed as one JSON line by `wcal virtual-bench`.
#[derive(Clone, Serialize, JsonSchema)]
pub struct Addresses {
    /// Path of the stage's pseudo-terminal.
    pub stage_pty: String,
    /// The stage on TCP.
    pub stage_tcp: SocketAddr,
    /// sm130, host:port.
    pub sm130: SocketAddr,
    /// The Hyperion.
    pub hyperion: HyperionAddresses,
    /// Cameras, host:port.
    pub cameras: Vec<SocketAddr>,
    /// Bench seconds per wall second.
    pub speed: f64,
    /// Tells programs on this computer when the bench's time stands, host:port.
    pub clock: SocketAddr,
}

/// Ports of the Hyperion.
#[derive(Clone, Serialize, JsonSchema)]
pub struct HyperionAddresses {
    /// host:port.
    pub commands: SocketAddr,
    /// Streamed peaks.
    pub peaks: SocketAddr,
}

/// A running bench; it ends when dropped.
pub struct VirtualBench {
    shared: Arc<BenchState>,
    addresses: Addresses,
    threads: Vec<JoinHandle<()>>,
}

impl VirtualBench {
    /// Starts all devices on loopback ports chosen by the system; `plant` is the wire.
    ///
    /// # Errors
    /// When a port or the pseudo-terminal cannot be opened.
    pub fn start(scenario: Scenario, plant: Box<dyn Plant>) -> io::Result<Self> {
        let (camera_count, speed) = (scenario.cameras.count, scenario.speed);
        let clock = BenchClock::start(speed);
        let shared = Arc::new(BenchState::new(scenario, plant, clock));
        let mut threads = Vec::new();
        let mut listen = |cable: Cable, serve: Serve| listen(&shared, &mut threads, cable, serve);
        let of_stage: Cable = Some(|faults| faults.stage_out);
        let of_interrogator: Cable = Some(|faults| faults.interrogator_out);
        let stage_tcp = listen(of_stage, |s, mut link| stage_server::serve(s, &mut link))?;
        let sm130 = listen(of_interrogator, sm130_server::serve)?;
        let commands = listen(of_interrogator, hyperion_server::serve)?;
        let peaks = listen(of_interrogator, hyperion_server::serve)?;
        let of_camera: [Serve; 2] = [
            |s, link| camera_server::serve(s, link, 0),
            |s, link| camera_server::serve(s, link, 1),
        ];
        let cameras = of_camera[..camera_count].iter();
        let cameras = cameras
            .map(|serve| listen(None, *serve))
            .collect::<io::Result<_>>()?;
        let clock = listen(None, serve_clock)?;
        let (master, slave) = TTYPort::pair()?;
        let stage_pty = slave.name().unwrap_or_default();
        threads.push(serve_pty(&shared, Pty { master, slave }));
        // Units reply with a scan from the first request on.
        shared.scan();
        threads.push(scanner(&shared));
        let addresses = Addresses {
            stage_pty,
            stage_tcp,
            sm130,
            hyperion: HyperionAddresses { commands, peaks },
            cameras,
            speed,
            clock,
        };
        Ok(Self {
            shared,
            addresses,
            threads,
        })
    }

    /// Where the devices answer.
    pub fn addresses(&self) -> &Addresses {
        &self.addresses
    }

    /// Makes something go wrong now.
    pub fn inject(&self, fault: Fault) {
        self.shared.inject(fault);
    }

    /// True stage position (mm) and speed (mm/s) now; for tests of what a fault left behind.
    pub fn true_stage(&self) -> (f64, f64) {
        let t_s = self.shared.clock.now_s();
        self.shared.world().units[0].axis.at(t_s)
    }

    /// Time for which the bench's clock stood, s of bench time, where that is much: this computer
    /// cannot hold its speed.
    pub fn fell_behind_s(&self) -> Option<f64> {
        let speed = self.shared.clock.speed();
        let behind_s = shared_time::stood().as_secs_f64() * speed;
        (behind_s > late_s(speed)).then_some(behind_s)
    }

    /// Bench time, s.
    pub fn now_s(&self) -> f64 {
        self.shared.clock.now_s()
    }
}

impl Drop for VirtualBench {
    fn drop(&mut self) {
        self.shared.shut_down();
        for thread in self.threads.drain(..) {
            // A server that panicked has already reported it.
            let _ = thread.join();
        }
    }
}

/// Longest wait for a client that takes nothing.
const SEND: Duration = Duration::from_secs(5);
/// A connection that is not answered in this time: the queue of the port is full.
const UNANSWERED: Duration = Duration::from_millis(100);
/// Most connections that fill a queue; the standard library asks for a queue of 128.
const QUEUE: usize = 200;
/// Between two looks of a thread at what there is to do.
const LOOK: Duration = Duration::from_millis(4);

/// Answers one client until it is gone.
type Serve = fn(&BenchState, TcpStream) -> io::Result<()>;
/// Whether the cable of a port is out; none where it hangs on no device's.
type Cable = Option<fn(&FaultState) -> bool>;

fn listen(
    shared: &Arc<BenchState>,
    threads: &mut Vec<JoinHandle<()>>,
    cable: Cable,
    serve: Serve,
) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let address = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let shared = Arc::clone(shared);
    threads.push(std::thread::spawn(move || {
        std::thread::scope(|clients| accept(&shared, &listener, address, cable, serve, clients));
    }));
    Ok(address)
}

fn accept<'s>(
    shared: &'s BenchState,
    listener: &TcpListener,
    address: SocketAddr,
    cable: Cable,
    serve: Serve,
    clients: &'s Scope<'s, '_>,
) {
    let mut queue = Vec::new();
    while shared.goes_on() {
        let [refuses, out] = cable.map_or([false; 2], |is_out| {
            let faults = guard(&shared.faults);
            [faults.never_accepts, is_out(&faults)]
        });
        if refuses {
            // With a full queue the system does not answer to another connection.
            if queue.is_empty() {
                let more = || TcpStream::connect_timeout(&address, UNANSWERED).ok();
                queue = std::iter::from_fn(more).take(QUEUE).collect();
            }
            std::thread::sleep(LOOK);
            continue;
        }
        queue.clear();
        match listener.accept() {
            // With the cable pulled no connection is accepted.
            Ok(_) if out => {}
            // Clients come and go; the end of a link is no event for the bench.
            Ok((link, _)) => drop(clients.spawn(move || answer(shared, link, serve).ok())),
            Err(_) => std::thread::sleep(LOOK),
        }
    }
}

fn answer(shared: &BenchState, link: TcpStream, serve: Serve) -> io::Result<()> {
    link.set_nonblocking(false)?;
    link.set_nodelay(true)?;
    // A client that takes nothing must not hold up the end of the bench.
    link.set_write_timeout(Some(SEND))?;
    serve(shared, link)
}

fn serve_pty(shared: &Arc<BenchState>, mut pty: Pty) -> JoinHandle<()> {
    let shared = Arc::clone(shared);
    std::thread::spawn(move || {
        while shared.goes_on() {
            // Ends when the cable is pulled: the pair is kept, but silent.
            let _ = stage_server::serve(&shared, &mut pty);
            std::thread::sleep(LOOK);
        }
    })
}

fn scanner(shared: &Arc<BenchState>) -> JoinHandle<()> {
    let shared = Arc::clone(shared);
    std::thread::spawn(move || {
        while !shared.stopping() {
            shared.scan();
            shared_time::lives(shared.behind());
            std::thread::sleep(LOOK);
        }
    })
}

/// Tells a program on this computer the bench's time, until it is gone.
fn serve_clock(shared: &BenchState, mut link: TcpStream) -> io::Result<()> {
    while shared.goes_on() {
        link.write_all(&shared_time::state_ns().map(u64::to_le_bytes).concat())?;
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Goes by the time of a bench on this computer until that ends.
///
/// # Errors
/// What the system says where it is not there.
pub fn follow_clock(address: &str) -> io::Result<()> {
    let mut link = TcpStream::connect(address)?;
    link.set_read_timeout(Some(shared_time::GONE))?;
    let mut hear = move || -> io::Result<()> {
        let mut state = [[0; 8]; 2];
        link.read_exact(state.as_flattened_mut())?;
        shared_time::follow(Some(state.map(u64::from_le_bytes)));
        Ok(())
    };
    hear()?;
    std::thread::spawn(move || {
        while hear().is_ok() {}
        shared_time::follow(None);
    });
    Ok(())
}
