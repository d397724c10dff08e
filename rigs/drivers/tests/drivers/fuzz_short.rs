//! The targets of `fuzz/` on a short random corpus: any bytes, no panic, and what holds for every
//! input.

use proptest::collection::vec;
use proptest::prelude::*;
use wcal_drivers::bench::{ascii, binary, unit::Unit};
use wcal_drivers::cameras::folder::parse_pgm;
use wcal_drivers::hyperion::frame;
use wcal_drivers::sm130::stream::{StreamDecoder, StreamItem};

/// The items as text: a peak without a value is NaN, which equals nothing.
fn items(bytes: &[u8], step: usize) -> Vec<String> {
    let (mut decoder, mut items) = (StreamDecoder::default(), Vec::new());
    for part in bytes.chunks(step.max(1)) {
        decoder.push(part);
        items.extend(
            std::iter::from_fn(|| decoder.next_item()).map(|item: StreamItem| format!("{item:?}")),
        );
    }
    items
}

/// Bytes near the truth find more than noise does: a stream of the corpus, with some bytes
/// replaced.
fn damaged_stream() -> impl Strategy<Value = Vec<u8>> {
    let corpus = include_bytes!("../corpus/token_inside.bin");
    vec((0..corpus.len(), any::<u8>()), 0..12).prop_map(|changes| {
        let mut bytes = corpus.to_vec();
        changes
            .into_iter()
            .for_each(|(at, value)| bytes[at] = value);
        bytes
    })
}

/// Characters of the protocol, so that commands come about.
fn zaber_line() -> impl Strategy<Value = Vec<u8>> {
    let words = [
        "/1 1 ",
        "/1 ",
        "/",
        "move abs ",
        "home",
        "stop",
        "get ",
        "set ",
        "pos",
        "accel ",
        "warnings clear",
        "-- ",
        "7",
        "-1",
        ":",
        "\\",
        "\u{ff}",
    ];
    vec(proptest::sample::select(words.to_vec()), 0..8).prop_map(|w| w.concat().into_bytes())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    #[test]
    fn sm130_items_do_not_depend_on_the_cuts(bytes in damaged_stream(), step in 1_usize..200) {
        prop_assert_eq!(items(&bytes, step), items(&bytes, bytes.len()));
    }

    #[test]
    fn sm130_noise_never_panics(bytes in vec(any::<u8>(), 0..400), step in 1_usize..50) {
        prop_assert_eq!(items(&bytes, step), items(&bytes, bytes.len()));
    }

    #[test]
    fn hyperion_responses_never_reach_past_their_bytes(bytes in vec(any::<u8>(), 0..300)) {
        if let Ok(Some((response, length))) = frame::response(&bytes) {
            prop_assert!(length <= bytes.len());
            let _ = frame::peaks(&response.content, 0.0);
        }
        let _ = frame::peaks(&bytes, 0.0);
    }

    #[test]
    fn any_line_to_the_virtual_unit_gets_whole_packets(lines in vec(zaber_line(), 1..6)) {
        let mut unit = Unit::new(1, Default::default());
        for (k, line) in lines.iter().enumerate() {
            if let Some(command) = ascii::parse(line) {
                for packet in unit.execute(&command, k as f64) {
                    prop_assert!(packet.ends_with("\r\n") && packet.is_ascii());
                }
            }
        }
    }

    #[test]
    fn binary_messages_come_back(bytes in any::<[u8; 6]>()) {
        prop_assert_eq!(binary::Message::from_bytes(bytes).bytes(), bytes);
    }

    #[test]
    fn pictures_have_as_many_pixels_as_they_say(bytes in vec(any::<u8>(), 0..200), head in "P5 [0-9]{1,3} [0-9]{1,3} 255\n") {
        let all = [head.as_bytes(), &bytes].concat();
        if let Ok((width, height, grey)) = parse_pgm(&all) {
            prop_assert_eq!(grey.len(), (width * height) as usize);
        }
    }
}
