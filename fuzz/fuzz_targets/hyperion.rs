//! Any bytes as response and as peak record.
#![no_main]
use libfuzzer_sys::fuzz_target;
use wcal_drivers::hyperion::frame;

fuzz_target!(|data: &[u8]| {
    if let Ok(Some((response, length))) = frame::response(data) {
        assert!(length <= data.len());
        let _ = frame::peaks(&response.content, 0.0);
    }
    let _ = frame::peaks(data, 0.0);
});
