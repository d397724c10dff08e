//! The live view speaks WebSocket to a Foxglove client: handshake, server info, the advertised channels.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};
use wcal_acquisition::recorder::Recorder;
use wcal_core::device::{Clocks, FbgReading};

fn handshake(address: SocketAddr, protocol: &str) -> TcpStream {
    let mut link = TcpStream::connect(address).unwrap();
    link.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let request = format!(
        "GET / HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
    );
    link.write_all(request.as_bytes()).unwrap();
    link
}

fn heard(link: &mut TcpStream, word: &str) -> String {
    let (end, mut bytes) = (Instant::now() + Duration::from_secs(10), Vec::new());
    let mut part = [0; 4096];
    while Instant::now() < end && !String::from_utf8_lossy(&bytes).contains(word) {
        match link.read(&mut part) {
            Ok(0) => break,
            Ok(count) => bytes.extend_from_slice(&part[..count]),
            Err(_) => {}
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn a_client_is_told_the_channels_of_the_recording() {
    let dir = tempfile::tempdir().unwrap();
    let recorder = Recorder::create(&dir.path().join("r.mcap"), Default::default()).unwrap();
    let view = recorder.serve("127.0.0.1:0".parse().unwrap()).unwrap();
    let mut client = handshake(view.address(), "foxglove.sdk.v1");
    let text = heard(&mut client, "/stage/position");
    assert!(text.starts_with("HTTP/1.1 101"), "{text}");
    assert!(text.contains("/fbg/scan") && text.contains("/stage/position"), "{text}");
    // Negative control: another protocol is refused.
    assert!(!heard(&mut handshake(view.address(), "chat"), "\r\n\r\n").starts_with("HTTP/1.1 101"));
    // An address in use is named; the recording goes on with and without the view.
    let taken = recorder.serve(view.address()).err().unwrap().to_string();
    assert!(taken.contains("live view at 127.0.0.1"), "{taken}");
    drop(view);
    let clocks = Clocks { host_s: 1.0, device_s: Some(1.0) };
    recorder.scan(&FbgReading { serial: 1, clocks, ..FbgReading::default() }).unwrap();
    recorder.finish().unwrap();
}
