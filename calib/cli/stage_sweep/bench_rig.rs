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
    let table = |t: &mut toml::Table, name: &str| -> Result<toml::Table> {
        let value = t
            .remove(name)
            .and_then(|v| v.try_into::<toml::Table>().ok());
        value.ok_or_else(|| anyhow!("expected [{name}] in the rig, found none"))
    };
    // The bench's clock may run faster than the wall's.
    if let Some(speed) = addresses.get("speed").and_then(serde_json::Value::as_f64) {
        rig.insert("clock_scale".to_owned(), speed.into());
    }
    if let Ok(clock) = text("/clock") {
        // A bench that has ended is named by its devices.
        let _ = wcal_drivers::bench::follow_clock(&clock);
    }
    let cameras = rig.get_mut("camera").and_then(toml::Value::as_array_mut);
    for (k, camera) in cameras.into_iter().flatten().enumerate() {
        let own = text(&format!("/cameras/{k}"))?;
        camera
            .as_table_mut()
            .map(|t| t.insert("source".to_owned(), own.into()));
    }
    let mut stage = table(&mut rig, "stage")?;
    stage.insert(
        "port".to_owned(),
        format!("tcp://{}", text("/stage_tcp")?).into(),
    );
    let mut interrogator = table(&mut rig, "interrogator")?;
    let driver = interrogator.get("driver").and_then(toml::Value::as_str);
    let own = addresses.get(driver.unwrap_or_default());
    let own = own.and_then(serde_json::Value::as_object);
    let own = own.ok_or_else(|| {
        anyhow!("expected the driver of a device under [interrogator] in the rig")
    })?;
    for (key, address) in own {
        let address = address.as_str().unwrap_or_default();
        interrogator.insert(key.clone(), address.into());
    }
    rig.insert("stage".to_owned(), stage.into());
    rig.insert("interrogator".to_owned(), interrogator.into());
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
    rig.remove("clock_scale");
    if rig.remove("camera").is_some() {
        eprintln!(
            "stage-sweep: the bench in this process draws no pictures: recorded without cameras (`wcal virtual-bench` has them)"
        );
    }
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
