//! Any bytes, cut anywhere: no panic, and the same items however the bytes were cut.
#![no_main]
use libfuzzer_sys::fuzz_target;
use wcal_drivers::sm130::stream::StreamDecoder;

fuzz_target!(|data: (u8, Vec<u8>)| {
    let (cut, bytes) = data;
    let all = |step: usize| {
        let (mut decoder, mut items) = (StreamDecoder::default(), Vec::new());
        for part in bytes.chunks(step.max(1)) {
            decoder.push(part);
            items.extend(std::iter::from_fn(|| decoder.next_item()));
        }
        items
    };
    // A peak without a value is NaN, which equals nothing.
    assert_eq!(format!("{:?}", all(usize::from(cut) + 1)), format!("{:?}", all(bytes.len())));
});
