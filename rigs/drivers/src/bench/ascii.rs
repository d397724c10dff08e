//! Packets of Zaber's ASCII protocol as the unit sees them: reads commands, writes replies.

use crate::zaber::checksum::lrc;

/// Longest packet a unit sends, without the line end.
const MAX_PACKET: usize = 80;

/// One command line, checked and split.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// Device address; 0 addresses all.
    pub device: u8,
    /// Axis; 0 addresses the whole device.
    pub axis: u8,
    /// Message id, echoed in the reply.
    pub id: Option<u8>,
    /// The words after the header.
    pub words: Vec<String>,
    /// The command carried a checksum.
    pub checked: bool,
}

/// Parses one line without its line end. `None`: a unit ignores such a line (noise, or a checksum
/// that does not fit).
pub fn parse(line: &[u8]) -> Option<Command> {
    // Noise before the last slash belongs to no command.
    let start = line.iter().rposition(|b| *b == b'/')?;
    let mut body = &line[start + 1..];
    let mut checked = false;
    if body.len() >= 3 && body[body.len() - 3] == b':' {
        let (text, sum) = body.split_at(body.len() - 3);
        let given = u8::from_str_radix(std::str::from_utf8(&sum[1..]).ok()?, 16).ok()?;
        if given != lrc(text) {
            return None;
        }
        (body, checked) = (text, true);
    }
    let text = std::str::from_utf8(body).ok()?.trim_end_matches('\r');
    let mut words: Vec<String> = text.split_whitespace().map(str::to_owned).collect();
    let mut header = [None::<u8>; 3];
    for slot in &mut header {
        let first = words.first();
        *slot = first.and_then(|word| word.parse().ok());
        // `--` requests a reply without id.
        let asks_for_none = first.is_some_and(|word| word == "--");
        if slot.is_some() || asks_for_none {
            words.remove(0);
        }
        if slot.is_none() {
            break;
        }
    }
    Some(Command {
        device: header[0].unwrap_or(0),
        axis: header[1].unwrap_or(0),
        id: header[2],
        words,
        checked,
    })
}

/// Reply of a unit.
pub(super) struct Answer {
    /// Whether the command was accepted.
    pub ok: bool,
    /// Data or the reason of refusal.
    pub data: String,
}

impl Answer {
    /// Accepted, with data.
    pub(super) fn ok(data: impl Into<String>) -> Self {
        Self {
            ok: true,
            data: data.into(),
        }
    }

    /// Refused, with the protocol's reason.
    pub(super) fn refused(reason: &str) -> Self {
        Self {
            ok: false,
            data: reason.to_owned(),
        }
    }
}

/// Sender and format of a reply.
pub(super) struct Header {
    /// Own address.
    pub device: u8,
    /// Axis addressed.
    pub axis: u8,
    /// Message id to echo.
    pub id: Option<u8>,
    /// Moving.
    pub busy: bool,
    /// Highest flag, `--` when there is none.
    pub flag: &'static str,
    /// Put checksums on what is sent.
    pub checked: bool,
}

impl Header {
    fn address(&self) -> String {
        match self.id {
            Some(id) => format!("{:02} {} {id:02}", self.device, self.axis),
            None => format!("{:02} {}", self.device, self.axis),
        }
    }

    fn seal(&self, mark: char, body: &str) -> String {
        match self.checked {
            true => format!("{mark}{body}:{:02X}\r\n", lrc(body.as_bytes())),
            false => format!("{mark}{body}\r\n"),
        }
    }

    fn state(&self) -> &str {
        if self.busy { "BUSY" } else { "IDLE" }
    }

    /// The reply; data that do not fit one packet continue in `cont` packets.
    pub(super) fn reply(&self, answer: &Answer) -> Vec<String> {
        let verdict = if answer.ok { "OK" } else { "RJ" };
        let (address, state) = (self.address(), self.state());
        let mut head = format!("{address} {verdict} {state} {}", self.flag);
        let (mut mark, mut rest) = ('@', answer.data.clone());
        let mut packets = Vec::new();
        loop {
            // One byte each for the mark and the backslash, three for the checksum.
            let room = MAX_PACKET.saturating_sub(head.len() + 6);
            let (part, more) = split_words(&rest, room);
            let goes_on = if more.is_empty() { "" } else { "\\" };
            packets.push(self.seal(mark, &format!("{head} {part}{goes_on}")));
            if more.is_empty() {
                return packets;
            }
            head = format!("{address} cont {}", packets.len());
            (mark, rest) = ('#', more);
        }
    }

    /// An alert: sent without a request.
    pub(super) fn alert(&self) -> String {
        let (device, axis, state) = (self.device, self.axis, self.state());
        self.seal('!', &format!("{device:02} {axis} {state} {}", self.flag))
    }
}

/// As many whole words as fit `room`, and the rest.
fn split_words(text: &str, room: usize) -> (String, String) {
    if text.len() <= room {
        return (text.to_owned(), String::new());
    }
    let cut = text[..room].rfind(' ').unwrap_or(room);
    (text[..cut].to_owned(), text[cut..].trim_start().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(checked: bool, id: Option<u8>) -> Header {
        Header {
            device: 1,
            axis: 1,
            id,
            busy: true,
            flag: "WR",
            checked,
        }
    }

    #[test]
    fn headers_with_and_without_axis_id_and_padding() {
        let c = parse(b"/1 1 move abs 10234").unwrap();
        assert_eq!((c.device, c.axis, c.id), (1, 1, None));
        assert_eq!(c.words, ["move", "abs", "10234"]);
        assert_eq!(parse(b"/01 0 07 get pos").unwrap().id, Some(7));
        assert_eq!(parse(b"/1 1 7 get pos").unwrap().id, Some(7));
        assert_eq!(parse(b"/1 1 -- get pos").unwrap().words, ["get", "pos"]);
        assert_eq!(parse(b"/").unwrap().words.len(), 0);
        assert_eq!(parse(b"garbage/2 1").unwrap().device, 2);
    }

    #[test]
    fn bad_checksums_noise_and_non_ascii_are_ignored() {
        let good = format!("/1 1 home:{:02X}", lrc(b"1 1 home"));
        assert!(parse(good.as_bytes()).unwrap().checked);
        assert_eq!(parse(b"/1 1 home:00"), None);
        assert_eq!(parse(b"/1 1 home:zz"), None);
        assert_eq!(parse(b"no command"), None);
        assert_eq!(parse(b"/1 \xff\xfe"), None);
        assert_eq!(parse(b""), None);
    }

    #[test]
    fn replies_follow_the_protocol() {
        assert_eq!(
            header(false, None).reply(&Answer::ok("0")),
            ["@01 1 OK BUSY WR 0\r\n"]
        );
        let checked = header(true, Some(7)).reply(&Answer::refused("BADDATA"));
        assert!(checked[0].starts_with("@01 1 07 RJ BUSY WR BADDATA:"));
        assert_eq!(header(false, None).alert(), "!01 1 BUSY WR\r\n");
    }

    #[test]
    fn long_data_go_on_in_further_packets_and_nothing_is_lost() {
        let data = (0..60).map(|k| k.to_string()).collect::<Vec<_>>().join(" ");
        let packets = header(true, Some(3)).reply(&Answer::ok(&*data));
        assert!(packets.len() > 2 && packets.iter().all(|p| p.len() <= MAX_PACKET + 2));
        let mut joined = String::new();
        for (k, p) in packets.iter().enumerate() {
            let body = p[1..].split(':').next().unwrap().trim_end_matches('\\');
            joined.push_str(
                &body
                    .split(' ')
                    .skip(if k == 0 { 6 } else { 5 })
                    .collect::<Vec<_>>()
                    .join(" "),
            );
            joined.push(' ');
        }
        assert_eq!(joined.trim(), data);
    }
}
