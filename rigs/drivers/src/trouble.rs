//! Why a device could not be opened, in words that say what to do.

use crate::host::is_timeout;
use std::io::{Error, ErrorKind};
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use wcal_core::deadline::Deadline;
use wcal_core::device::{DeviceError, DeviceErrorKind};

/// What the rigs of a virtual bench have for a port number that is not known yet.
const PLACEHOLDER: &str = "PORT";
/// Most processes that are looked at for a port in use.
const PROCESSES: usize = 100_000;

/// A connection that was not made.
pub(crate) fn of_connection(
    device: &str,
    address: &str,
    error: &Error,
    deadline: &Deadline,
) -> DeviceError {
    if address.rsplit(':').next() == Some(PLACEHOLDER) {
        let found = format!(
            "the placeholder {PLACEHOLDER} in {address}: `--bench ADDRESSES.json` fills in what `wcal virtual-bench` prints"
        );
        return fail(
            DeviceErrorKind::Configuration,
            device,
            "an address with a port number",
            &found,
        );
    }
    if is_timeout(error) {
        return deadline.error(
            device,
            "open",
            "a connection",
            "no answer from this address",
        );
    }
    let found = match error.kind() {
        // On this computer's own address the virtual bench is missing, else a unit.
        ErrorKind::ConnectionRefused if is_loopback(address) => format!(
            "nothing that listens at {address}: is `wcal virtual-bench` still running? its addresses are new at each start"
        ),
        ErrorKind::ConnectionRefused => {
            format!("nothing that listens at {address}: is the unit switched on, is this its port?")
        }
        _ => format!("{error} at {address}"),
    };
    fail(
        DeviceErrorKind::Disconnected,
        device,
        "a listening unit",
        &found,
    )
}

/// A serial port that was not opened.
pub(crate) fn of_serial_port(
    device: &str,
    path: &str,
    error: &Error,
    deadline: &Deadline,
) -> DeviceError {
    let found = match error.kind() {
        ErrorKind::NotFound => absent(path),
        ErrorKind::PermissionDenied => forbidden(path),
        ErrorKind::ResourceBusy => busy(path, Path::new("/proc")),
        _ if is_timeout(error) => {
            return deadline.error(device, "open", "an open port", "none");
        }
        _ => format!("{error} at {path}"),
    };
    fail(
        DeviceErrorKind::Disconnected,
        device,
        "a free serial port",
        &found,
    )
}

fn fail(kind: DeviceErrorKind, device: &str, expected: &str, found: &str) -> DeviceError {
    DeviceError::new(kind, device, "open", expected, found)
}

fn is_loopback(address: &str) -> bool {
    let host = address
        .rsplit_once(':')
        .map_or(address, |(host, _)| host)
        .trim_matches(['[', ']']);
    host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// No such file; the ports that there are.
fn absent(path: &str) -> String {
    let is_port = |name: &str| {
        ["ttyUSB", "ttyACM"]
            .iter()
            .any(|head| name.starts_with(head))
    };
    let names = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    let mut there: Vec<String> = names
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .filter(|name| is_port(name))
        .collect();
    there.sort();
    let list = if there.is_empty() {
        "none".to_owned()
    } else {
        there.join(", ")
    };
    format!("no {path}: is the cable plugged in? serial ports under /dev: {list}")
}

/// A port of another user or group.
fn forbidden(path: &str) -> String {
    // The system says "permission denied": joining the port's group is the way out.
    let gid = std::fs::metadata(path).ok().map(|m| m.gid());
    let groups = wcal_core::files::read_text(Path::new("/etc/group")).unwrap_or_default();
    let name = gid.and_then(|gid| {
        let fields = groups
            .lines()
            .map(|line| line.split(':').collect::<Vec<_>>());
        fields
            .filter(|f| f.get(2).is_some_and(|id| id.parse() == Ok(gid)))
            .find_map(|f| f.first().map(|n| (*n).to_owned()))
    });
    let group = name.unwrap_or_else(|| "dialout".to_owned());
    format!(
        "no permission for {path}: its group is {group} (`sudo usermod -aG {group} USER`, then log in again)"
    )
}

/// A port that somebody has; who, where the system shows it.
fn busy(path: &str, processes: &Path) -> String {
    match holder(path, processes) {
        Some((id, name)) => format!("{path} in use by process {id} ({name})"),
        None => format!("{path} in use by another process"),
    }
}

/// The first process with an open file of this path: its number and name (Linux: the links in
/// `/proc/N/fd`, proc(5)).
fn holder(path: &str, processes: &Path) -> Option<(u32, String)> {
    let port = std::fs::canonicalize(path).ok()?;
    let has = |folder: &Path| {
        let open = std::fs::read_dir(folder.join("fd"))
            .into_iter()
            .flatten()
            .flatten();
        open.into_iter()
            .any(|entry| std::fs::read_link(entry.path()).is_ok_and(|to| to == port))
    };
    let all = std::fs::read_dir(processes).ok()?.flatten().take(PROCESSES);
    let mut found: Vec<u32> = all
        .filter(|entry| has(&entry.path()))
        .filter_map(|entry| entry.file_name().to_string_lossy().parse().ok())
        .collect();
    found.sort_unstable();
    let id = *found.first()?;
    let name = wcal_core::files::read_text(processes.join(id.to_string()).join("comm")).ok()?;
    Some((id, name.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn said(path: &str, kind: ErrorKind) -> String {
        let deadline = Deadline::uninterruptible(Duration::from_secs(1));
        of_serial_port("stage", path, &kind.into(), &deadline).to_string()
    }

    fn said_of_address(address: &str, kind: ErrorKind) -> String {
        let deadline = Deadline::uninterruptible(Duration::from_secs(1));
        of_connection("stage", address, &kind.into(), &deadline).to_string()
    }

    #[test]
    fn absent_forbidden_busy_and_anything_else_are_four_messages() {
        let port = "/dev/ttyNONE";
        let words = [
            (
                ErrorKind::NotFound,
                "no /dev/ttyNONE: is the cable plugged in? serial ports under /dev: ",
            ),
            (
                ErrorKind::PermissionDenied,
                "no permission for /dev/ttyNONE: its group is dialout",
            ),
            (
                ErrorKind::ResourceBusy,
                "/dev/ttyNONE in use by another process",
            ),
            (ErrorKind::InvalidData, "invalid data at /dev/ttyNONE"),
        ];
        for (kind, word) in words {
            let said = said(port, kind);
            assert!(said.contains(word), "{said}");
            let others = words.iter().filter(|(other, _)| *other != kind);
            assert!(
                others.into_iter().all(|(_, word)| !said.contains(word)),
                "control: {said}"
            );
        }
    }

    #[test]
    fn the_group_of_a_port_is_named() {
        let of_root = forbidden("/proc/version");
        assert!(
            of_root.contains("its group is root (`sudo usermod -aG root USER`"),
            "{of_root}"
        );
    }

    #[test]
    fn a_port_in_use_names_the_process() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("port");
        std::fs::write(&path, "").unwrap();
        let said = busy(&path.display().to_string(), Path::new("/proc"));
        assert!(
            said.ends_with("in use by another process"),
            "control: {said}"
        );
        let open = std::fs::File::open(&path).unwrap();
        let said = busy(&path.display().to_string(), Path::new("/proc"));
        assert!(
            said.contains(&format!("in use by process {} (", std::process::id())),
            "{said}"
        );
        drop(open);
    }

    #[test]
    fn a_refused_connection_and_a_placeholder_say_what_to_do() {
        let refused = |address: &str| said_of_address(address, ErrorKind::ConnectionRefused);
        for address in ["127.0.0.1:4000", "localhost:4000", "[::1]:4000"] {
            let said = refused(address);
            assert!(
                said.contains(&format!(
                    "nothing that listens at {address}: is `wcal virtual-bench` still"
                )),
                "{said}"
            );
        }
        let real = refused("10.0.0.126:1852");
        assert!(
            real.contains("is the unit switched on") && !real.contains("virtual-bench"),
            "{real}"
        );
        let rig = said_of_address("127.0.0.1:PORT", ErrorKind::InvalidInput);
        assert!(
            rig.contains("the placeholder PORT in 127.0.0.1:PORT: `--bench"),
            "{rig}"
        );
        let port = said_of_address("127.0.0.1:40000", ErrorKind::InvalidInput);
        assert!(!port.contains("placeholder"), "control: {port}");
    }
}
