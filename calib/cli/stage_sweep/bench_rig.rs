//! A rig whose devices are those of a virtual bench: served at addresses, or within this process.

use anyhow::{Result, anyhow, ensure};
use std::path::Path;
use wcal_acquisition::reduce::recordings;
use wcal_acquisition::replay::{Message, read};

/// Puts the addresses of a virtual bench into a rig, and goes by its time.
pub(crate) fn with_addresses(rig: &str, addresses: &str) -> Result<String> {
    ensure!(
        !addresses.trim().is_empty(),
        "the file is empty: `wcal virtual-bench` is still starting, or it failed"
    );
    let addresses = wcal_core::document::json(addresses)?;
    let text = |pointer: &str| {
        let value = addresses
            .pointer(pointer)
            .and_then(serde_json::Value::as_str);
        value
            .map(str::to_owned)
            .ok_or_else(|| anyhow!("expected {pointer}, found nothing"))
    };
    let mut rig = wcal_core::document::toml(rig)?;
    // The bench's clock may run faster than the wall's.
    if let Some(speed) = addresses.get("speed").and_then(serde_json::Value::as_f64) {
        rig.insert("clock_scale".to_owned(), speed.into());
    }
    if let Ok(clock) = text("/clock") {
        // A bench that has ended is named by its devices.
        let _ = wcal_drivers::bench::follow_clock(&clock);
    }
    // The bench has its own names: a camera is found by its place in the rig.
    let cameras = rig.get_mut("camera").and_then(toml::Value::as_array_mut);
    for (k, camera) in cameras.into_iter().flatten().enumerate() {
        let own = text(&format!("/cameras/{k}"))?;
        camera
            .as_table_mut()
            .map(|t| t.insert("source".to_owned(), own.into()));
    }
    let driver = rig
        .get("interrogator")
        .and_then(|i| i.get("driver")?.as_str());
    // One port is an address, several have names.
    let own = addresses.get(driver.unwrap_or_default());
    let port = |name: &str| own.and_then(|own| own.get(name)?.as_str());
    let address = own.and_then(|own| own.as_str()).or(port("commands"));
    let address = address.ok_or_else(|| {
        anyhow!("expected the driver of a device under [interrogator] in the rig")
    })?;
    let mut set = |table: &str, key: &str, address: &str| -> Result<()> {
        let entries = rig.get_mut(table).and_then(toml::Value::as_table_mut);
        let entries =
            entries.ok_or_else(|| anyhow!("expected [{table}] in the rig, found none"))?;
        entries.insert(key.to_owned(), address.into());
        Ok(())
    };
    set("stage", "port", &format!("tcp://{}", text("/stage_tcp")?))?;
    set("interrogator", "address", address)?;
    if let Some(peaks) = port("peaks") {
        set("interrogator", "peaks_address", peaks)?;
    }
    Ok(toml::to_string(&rig)?)
}

/// The rig of a bench in this process: nobody else drives its stage, its time is the rig's, its
/// rate is the scenario's, and it draws no pictures.
pub(super) fn in_this_process(rig: &str, own_hz: f64) -> Result<String> {
    let mut rig = wcal_core::document::toml(rig)?;
    let stated = rig.get("interrogator").and_then(|i| i.get("rate_hz"));
    if let Some(rig_hz) =
        stated.and_then(|hz| hz.as_float().or(hz.as_integer().map(|hz| hz as f64)))
    {
        ensure!(
            (own_hz - rig_hz).abs() <= 1e-6 * own_hz,
            "interrogator.rate_hz: expected the scenario's {own_hz} Hz, found {rig_hz}: change it, or rate_hz under [interrogator] of the \
             scenario"
        );
    }
    // Its time is the rig's own: there is no second clock that could run faster.
    rig.remove("clock_scale");
    if rig.remove("camera").is_some() {
        eprintln!(
            "stage-sweep: the bench in this process draws no pictures: recorded without cameras (`wcal virtual-bench` has them)"
        );
    }
    // Locks go by the port: sessions in other processes have stages of their own.
    if let Some(stage) = rig.get_mut("stage").and_then(toml::Value::as_table_mut) {
        stage.insert(
            "port".to_owned(),
            format!("in-process:{}", std::process::id()).into(),
        );
    }
    Ok(toml::to_string(&rig)?)
}

/// How far the bench's time of earlier runs of a session is ahead of the wall's, s: a bench in this
/// process goes on after them.
pub(super) fn ahead_s(session: &Path) -> Result<f64> {
    let mut last_s = f64::NEG_INFINITY;
    for part in recordings(session) {
        read(&part, |message| {
            if let Message::Scan(scan) = message {
                last_s = last_s.max(scan.host_s);
            }
        })?;
    }
    Ok(last_s - jiff::Timestamp::now().as_duration().as_secs_f64())
}
