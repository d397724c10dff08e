//! Ctrl-C, SIGTERM and SIGHUP: each asks for an end, and what runs comes to a safe one.

use anyhow::{Context, Result};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::sync::OnceLock;
use wcal_core::deadline::{Interrupt, Signal};

static INTERRUPT: OnceLock<Interrupt> = OnceLock::new();

/// From here on a signal asks for an end instead of ending the program at once.
///
/// # Errors
/// When the system does not give the signals.
pub(crate) fn watch() -> Result<Interrupt> {
    let interrupt = INTERRUPT.get_or_init(Interrupt::default).clone();
    let mut wanted = vec![SIGINT, SIGTERM];
    // Under `nohup` a program is to outlive its terminal.
    if !is_ignored(SIGHUP) {
        wanted.push(SIGHUP);
    }
    let mut signals = Signals::new(&wanted).context("watching for Ctrl-C")?;
    let heard = interrupt.clone();
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            for signal in signals.forever() {
                heard.set(match signal {
                    SIGTERM => Signal::Terminate,
                    SIGHUP => Signal::HangUp,
                    _ => Signal::CtrlC,
                });
            }
        })
        .context("watching for Ctrl-C")?;
    Ok(interrupt)
}

/// Whether a signal asks for an end now; for those who wait for a person.
pub(crate) fn signal() -> Option<Signal> {
    INTERRUPT.get().and_then(Interrupt::signal)
}

/// Whether the process was started with this signal ignored (Linux: the mask in
/// `/proc/self/status`, proc(5)).
fn is_ignored(signal: i32) -> bool {
    let status = wcal_core::files::read_text("/proc/self/status").unwrap_or_default();
    let mask = status
        .lines()
        .find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
