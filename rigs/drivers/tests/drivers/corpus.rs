//! The sm130 byte corpus (tests/corpus, written by a program of its own): every framing variant,
//! cut in every way.

use serde_json::Value;
use std::path::Path;
use wcal_drivers::sm130::frame::Frame;
use wcal_drivers::sm130::stream::{StreamDecoder, StreamItem};

fn decode(bytes: &[u8], step: usize) -> (Vec<Frame>, u64) {
    let mut decoder = StreamDecoder::default();
    decoder.set_streaming(true);
    let mut frames = Vec::new();
    for part in bytes.chunks(step) {
        decoder.push(part);
        while let Some(item) = decoder.next_item() {
            if let StreamItem::Frame(frame) = item {
                frames.push(frame);
            }
        }
    }
    (frames, decoder.skipped())
}

fn cases() -> Vec<(String, Value, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let text = std::fs::read_to_string(folder.join("expected.json")).unwrap();
    let expected: serde_json::Map<String, Value> = serde_json::from_str(&text).unwrap();
    let read = |(name, value): (String, Value)| {
        let bytes = std::fs::read(folder.join(format!("{name}.bin"))).unwrap();
        (name, value, bytes)
    };
    expected.into_iter().map(read).collect()
}

#[test]
fn every_stream_of_the_corpus_decodes_however_it_is_cut() {
    let cases = cases();
    assert_eq!(cases.len(), 10);
    for (name, expected, bytes) in cases {
        for step in [1, 7, 98, 512, bytes.len()] {
            let (frames, skipped) = decode(&bytes, step);
            let serials: Vec<Value> = frames.iter().map(|f| f.serial.into()).collect();
            assert_eq!(
                Value::Array(serials),
                expected["serials"],
                "{name} by {step}"
            );
            assert_eq!(
                Value::from(skipped),
                expected["skipped"],
                "{name} by {step}"
            );
            for (frame, faults) in frames.iter().zip(expected["faults"].as_array().unwrap()) {
                assert_eq!(
                    serde_json::to_value(frame.health.faults()).unwrap(),
                    *faults,
                    "{name}"
                );
            }
            if name.starts_with("token") {
                assert_eq!(frames[1].peaks_nm[0], [1535.801, 1537.3, 1541.2005]);
                assert_eq!(frames[1].peaks_nm[2], [1550.25]);
                assert!((frames[1].device_s - 1_700_000_000.000_5).abs() < 1e-6);
            }
        }
    }
}

/// Negative control: one wrong byte anywhere in a frame's checked fields costs that frame, never
/// the others.
#[test]
fn a_wrong_byte_costs_at_most_its_own_frame() {
    let (_, _, bytes) = cases().into_iter().find(|c| c.0 == "token_inside").unwrap();
    let whole = decode(&bytes, bytes.len()).0.len();
    let length = bytes.len() / whole;
    for at in 0..length {
        let mut wrong = bytes.clone();
        wrong[5 * length + at] ^= 0x55;
        let serials: Vec<u32> = decode(&wrong, 512).0.iter().map(|f| f.serial).collect();
        let others = (100..112).filter(|s| *s != 105);
        assert!(
            others.clone().all(|s| serials.contains(&s)),
            "byte {at}: {serials:?}"
        );
    }
    let mut wrong = bytes;
    wrong[5 * length] = b'x';
    assert_eq!(decode(&wrong, 512).0.len(), whole - 1);
}
