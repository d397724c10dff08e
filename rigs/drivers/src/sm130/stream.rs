//! Finds frames and text replies in the byte stream, however TCP has cut it.

use super::frame::{self, Frame, HEADER};

/// Digits of the length before every reply.
const PREFIX: usize = 10;
/// Ends a streamed frame; inside or outside the stated length, by source.
const TOKEN: &[u8; 8] = b"XXXXXXXX";
/// Ends the answer to "stop streaming".
const STOP_TOKEN: &[u8; 8] = b"ZZZZZZZZ";
/// Every text reply about streaming starts so.
const STREAM_TEXT: &[u8] = b"Streaming data";
/// Longer text replies are not known (a spectrum is 65,536 bytes and is binary).
const MAX_TEXT: usize = 4096;

/// What the stream held next.
#[derive(Debug, Clone, PartialEq)]
pub enum StreamItem {
    /// A data frame.
    Frame(Frame),
    /// A text reply.
    Text(String),
    /// The end of streaming.
    Stopped,
}

/// Incremental decoder; resynchronises byte by byte.
#[derive(Debug, Default)]
pub struct StreamDecoder {
    buffer: Vec<u8>,
    at: usize,
    skipped: u64,
    streaming: bool,
}

/// Outcome of one parse of the buffer.
enum Parsed {
    Found(usize, StreamItem),
    Token(usize),
    NeedMore,
    Garbage,
}

impl StreamDecoder {
    /// Appends bytes as they came.
    pub fn push(&mut self, bytes: &[u8]) {
        // Not after every frame: each time moves all the bytes behind it.
        if self.at > 64 * 1024 {
            self.buffer.drain(..self.at);
            self.at = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Takes over what came.
    pub(crate) fn take(&mut self, buffer: &mut Vec<u8>) {
        self.push(buffer);
        buffer.clear();
    }

    /// While frames stream, the only text is about streaming: noise that looks like a short text is
    /// noise.
    pub fn set_streaming(&mut self, on: bool) {
        self.streaming = on;
    }

    /// Bytes that belonged to no frame.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The next item; `None` until more bytes come.
    pub fn next_item(&mut self) -> Option<StreamItem> {
        loop {
            match parse_next(&self.buffer[self.at..], self.streaming) {
                Parsed::Found(length, item) => {
                    self.at += length;
                    return Some(item);
                }
                Parsed::Token(length) => self.at += length,
                Parsed::NeedMore => return None,
                Parsed::Garbage => {
                    self.at += 1;
                    self.skipped += 1;
                }
            }
        }
    }
}

fn parse_next(rest: &[u8], streaming: bool) -> Parsed {
    // Before a length is looked for: by one of three sources a token stands outside of it.
    for token in [TOKEN, STOP_TOKEN] {
        let known = rest.len().min(token.len());
        if known > 0 && rest[..known] == token[..known] {
            return match (known == token.len(), token == STOP_TOKEN) {
                (false, _) => Parsed::NeedMore,
                (true, false) => Parsed::Token(known),
                (true, true) => Parsed::Found(known, StreamItem::Stopped),
            };
        }
    }
    if rest.len() < PREFIX {
        let possible = rest.iter().all(|b| b.is_ascii_digit() || *b == b' ');
        return if possible {
            Parsed::NeedMore
        } else {
            Parsed::Garbage
        };
    }
    let Some(stated) = prefix_length(&rest[..PREFIX]) else {
        return Parsed::Garbage;
    };
    let body = &rest[PREFIX..];
    if stated >= HEADER {
        if body.len() < HEADER {
            // Text of this length would show itself by its first bytes; a frame starts with a
            // binary header.
            return Parsed::NeedMore;
        }
        // Two sources count the token in the stated length, a third does not: both are frames.
        if let Ok(length) = frame::frame_length(body)
            && (stated == length || stated == length + TOKEN.len())
        {
            if body.len() < stated {
                return Parsed::NeedMore;
            }
            return match frame::decode(body) {
                Ok(frame) => Parsed::Found(PREFIX + stated, StreamItem::Frame(frame)),
                Err(_) => Parsed::Garbage,
            };
        }
    }
    if stated == 0 || stated > MAX_TEXT || !body.iter().take(stated).all(|b| is_text(*b)) {
        return Parsed::Garbage;
    }
    let known = body.len().min(STREAM_TEXT.len());
    if streaming && (stated < STREAM_TEXT.len() || body[..known] != STREAM_TEXT[..known]) {
        return Parsed::Garbage;
    }
    if body.len() < stated {
        return Parsed::NeedMore;
    }
    let text = &body[..stated];
    // Where the stop token counts as part of the reply, leave it for the next parse.
    let text = text.strip_suffix(STOP_TOKEN).unwrap_or(text);
    Parsed::Found(
        PREFIX + text.len(),
        StreamItem::Text(String::from_utf8_lossy(text).into_owned()),
    )
}

fn is_text(b: u8) -> bool {
    b.is_ascii_graphic() || matches!(b, b' ' | b'\n' | b'\r' | b'\t')
}

/// The decimal length, padded with zeros or spaces on either side.
fn prefix_length(prefix: &[u8]) -> Option<usize> {
    let digits = std::str::from_utf8(prefix).ok()?.trim_matches(' ');
    // `parse` accepts a sign, which the test of the first bytes alone rejects.
    digits
        .bytes()
        .all(|b| b.is_ascii_digit())
        .then(|| digits.parse().ok())
        .flatten()
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::sample_frame;
    use super::*;

    fn framed(payload: &[u8], token: &str) -> Vec<u8> {
        let (stated, tail): (usize, &[u8]) = match token {
            "inside" => (payload.len() + 8, TOKEN),
            "outside" => (payload.len(), TOKEN),
            _ => (payload.len(), b""),
        };
        [format!("{stated:010}").as_bytes(), payload, tail].concat()
    }

    fn drain(decoder: &mut StreamDecoder) -> Vec<u32> {
        let mut serials = Vec::new();
        while let Some(item) = decoder.next_item() {
            if let StreamItem::Frame(f) = item {
                serials.push(f.serial);
            }
        }
        serials
    }

    #[test]
    fn frames_decode_for_every_token_position_padding_and_split() {
        for token in ["inside", "outside", "none"] {
            for spaces in [false, true] {
                let mut stream: Vec<u8> = (0..20)
                    .flat_map(|k| framed(&sample_frame(k), token))
                    .collect();
                if spaces {
                    let text = format!(
                        "{:10}",
                        sample_frame(0).len() + if token == "inside" { 8 } else { 0 }
                    );
                    stream[..10].copy_from_slice(text.as_bytes());
                }
                for chunk in [1, 2, 3, 7, 97, 98, 99, 1000, 100_000] {
                    let mut decoder = StreamDecoder::default();
                    let mut serials = Vec::new();
                    for part in stream.chunks(chunk) {
                        decoder.push(part);
                        serials.extend(drain(&mut decoder));
                    }
                    assert_eq!(serials, (0..20).collect::<Vec<_>>(), "{token} {chunk}");
                    assert_eq!(decoder.skipped(), 0);
                }
            }
        }
    }

    #[test]
    fn a_sign_before_a_length_is_no_length_however_the_stream_is_cut() {
        let mut stream = framed(&sample_frame(0), "inside");
        stream.extend(framed(&sample_frame(1), "inside"));
        let second = stream.len() / 2;
        stream[second] = b'+';
        for chunk in [1, 1000] {
            let mut decoder = StreamDecoder::default();
            let mut serials = Vec::new();
            for part in stream.chunks(chunk) {
                decoder.push(part);
                serials.extend(drain(&mut decoder));
            }
            assert_eq!(serials, [0], "{chunk}");
        }
    }

    #[test]
    fn garbage_between_frames_costs_only_the_garbage() {
        let mut stream = Vec::new();
        for k in 0..10 {
            stream.extend(framed(&sample_frame(k), "outside"));
            stream.extend(&[b'X', 0, 255, b'0', b'0', b'9', b'Z'][..(k as usize % 8).min(7)]);
        }
        let mut decoder = StreamDecoder::default();
        decoder.set_streaming(true);
        decoder.push(&stream);
        assert_eq!(drain(&mut decoder), (0..10).collect::<Vec<_>>());
        assert!(decoder.skipped() > 0);
    }

    #[test]
    fn a_truncated_frame_is_lost_alone() {
        let mut stream = framed(&sample_frame(0), "inside");
        stream.extend(&framed(&sample_frame(1), "inside")[..60]);
        stream.extend(framed(&sample_frame(2), "inside"));
        stream.extend(framed(&sample_frame(3), "inside"));
        let mut decoder = StreamDecoder::default();
        decoder.push(&stream);
        assert_eq!(drain(&mut decoder), [0, 2, 3]);
        assert_eq!(decoder.skipped(), 60);
    }

    #[test]
    fn text_replies_and_the_end_of_streaming_are_found_among_frames() {
        let mut stream = framed(b"Streaming data enabled.\n", "none");
        stream.extend(framed(&sample_frame(5), "inside"));
        stream.extend(framed(b"Streaming data disabled.\n", "none"));
        stream.extend(STOP_TOKEN);
        let mut decoder = StreamDecoder::default();
        decoder.push(&stream);
        assert_eq!(
            decoder.next_item(),
            Some(StreamItem::Text("Streaming data enabled.\n".to_owned()))
        );
        assert!(matches!(decoder.next_item(), Some(StreamItem::Frame(_))));
        assert_eq!(
            decoder.next_item(),
            Some(StreamItem::Text("Streaming data disabled.\n".to_owned()))
        );
        assert_eq!(decoder.next_item(), Some(StreamItem::Stopped));
        assert_eq!(decoder.next_item(), None);
    }

    #[test]
    fn a_corrupt_header_never_yields_a_frame() {
        let mut bad = sample_frame(1);
        bad[72..76].fill(0);
        let mut decoder = StreamDecoder::default();
        decoder.push(&framed(&bad, "inside"));
        assert_eq!(decoder.next_item(), None);
        assert!(decoder.skipped() > 0);
    }
}
