//! `wcal track`: from wavelengths to contact points: of a table, of a recording, or live.

mod arguments;
mod feed;
mod live;
mod live_track;
mod object;
mod output;
mod recorded_motion;
mod table;

use anyhow::{Context, Result, anyhow, bail};
use arguments::RATE_HZ;
pub use arguments::TrackArgs;
use std::collections::btree_map::{BTreeMap, Entry};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_acquisition::rig::Rig;
use wcal_core::Purpose;
use wcal_core::files::read_text;
use wcal_network::Tracker;
use wcal_network::model_file::{load, read_card};
use wcal_session::sweep_session::SweepSession;
use wcal_track::groove_comparison::contact_sentence;
use wcal_track::table_source::median_step_s;
use wcal_track::trust::WhiskerModel;
pub use wcal_track::trust::filters_for;

/// Where readings come from.
enum Source {
    Table(PathBuf),
    /// A session folder along the known way of its groove.
    Session(PathBuf),
    Recordings(Vec<PathBuf>),
    Interrogator,
}

/// Runs the command.
///
/// # Errors
/// Where a file or device cannot be used, or a row has no time.
pub fn run(args: &TrackArgs) -> Result<ExitCode> {
    // A wrong --out is refused before a network is loaded or a device opened.
    output::check(args)?;
    if let Some(tare_s) = args.tare_s.filter(|s| !(s.is_finite() && *s >= 0.0)) {
        bail!("--tare-s: expected 0 or more, found {tare_s}");
    }
    if let Some(sd) = args.diameter_sd.filter(|sd| !(0.0..=0.2).contains(sd)) {
        bail!("--diameter-sd: expected a share from 0 to 0.2, found {sd}");
    }
    let (source, rig) = source(args)?;
    if args.live_page.is_some() && rig.is_none() {
        bail!("--live-page: expected a stream or its recording, found a table or a session");
    }
    let names: Vec<String> = match &rig {
        Some((_, rig)) => rig
            .interrogator
            .whiskers()
            .iter()
            .map(|w| (*w).to_owned())
            .collect(),
        None => vec![String::new()],
    };
    let folders = match args.model[..] {
        [] => BTreeMap::new(),
        _ => by_whisker("--model", &args.model, &names)?,
    };
    let session = match &source {
        Source::Session(folder) => Some(table::load_session(args, folder)?),
        _ => None,
    };
    let mut checked = Vec::new();
    for (name, place) in by_whisker("--calibration", &args.calibration, &names)? {
        let card = folders
            .get(&name)
            .map(|folder| read_card(folder))
            .transpose()?;
        checked.push(WhiskerModel::read(&name, &place, card)?);
    }
    // A network learned from readings of one pace; readings of another one mislead it.
    let step_s = match &source {
        Source::Table(path) => median_step_s(path)?,
        _ => Some(1.0 / RATE_HZ),
    };
    for one in &mut checked {
        one.check_step(step_s);
        if let Some(session) = &session {
            one.check_session(&session.whisker);
        }
    }
    if !trusted(args, &checked) {
        eprintln!(
            "track: exit code 4: nothing was written; verify the calibration anew, take the model of this whisker and pace, or pass --force: every \
             row then says so"
        );
        return Ok(ExitCode::from(4));
    }
    // A stream or a network takes no zero by itself.
    let own_zero =
        !args.model.is_empty() || matches!(source, Source::Recordings(_) | Source::Interrogator);
    for one in checked
        .iter()
        .filter(|_| own_zero && args.tare_s.is_none_or(|s| s == 0.0))
    {
        if one.file.model.whisker().is_some_and(|w| !w.knows_zero()) {
            bail!("{}: {}", one.place.display(), table::NO_ZERO);
        }
    }
    // Whiskers may share a network: each folder is loaded once.
    let mut trackers: BTreeMap<&PathBuf, Tracker> = BTreeMap::new();
    for folder in folders.values() {
        if let Entry::Vacant(place) = trackers.entry(folder) {
            place.insert(load(folder)?.0);
        }
    }
    for one in &mut checked {
        let folder = folders.get(&one.name);
        one.tracker = folder.and_then(|folder| trackers.get(folder));
    }
    match (source, rig, session) {
        (Source::Table(path), ..) => table::track(
            args,
            &path,
            table::of_table(args, &path, &checked[0])?,
            &checked[0],
        ),
        (Source::Session(folder), _, Some(session)) => table::track(
            args,
            &folder,
            table::of_session(&session, &checked[0])?,
            &checked[0],
        ),
        (Source::Recordings(parts), Some((place, rig)), _) => {
            live::replay(args, &parts, &place, &rig, &checked)
        }
        (_, Some((place, rig)), _) => live::track(args, &place, &rig, &checked),
        (_, None, _) => bail!("expected --rig RIG for a stream, found none"),
    }
}

/// Prints why calibrations or models cannot be trusted, and the contact's uncertainty; returns
/// whether rows may be written.
fn trusted(args: &TrackArgs, checked: &[WhiskerModel<'_>]) -> bool {
    let mut doubted = false;
    for one in checked {
        if one.file.whisker.is_none() && !args.model.is_empty() {
            let place = one.place.display();
            eprintln!(
                "warning: {place}: it does not say of which whisker; the model is taken to fit"
            );
        }
        for doubt in one.doubts.messages() {
            doubted = true;
            let what = if args.force { "warning" } else { "refused" };
            eprintln!("{what}: {}{doubt}", whose(&one.name));
        }
    }
    if doubted && !args.force {
        return false;
    }
    for WhiskerModel { name, file, .. } in checked {
        if let Some(contact) = &file.contact_uncertainty {
            eprintln!("{}{}", whose(name), contact_sentence(contact));
        }
        if file.verification == wcal_core::VerificationStatus::Reverified {
            let said = "verified on sealed readings that another decision had met before";
            eprintln!("{}{said}", whose(name));
        }
    }
    true
}

/// Of which of several whiskers a message speaks; nothing where it has no name.
fn whose(name: &str) -> String {
    if name.is_empty() {
        String::new()
    } else {
        format!("whisker {name}: ")
    }
}

/// The points table of a session folder.
fn points_table(folder: &Path) -> Result<PathBuf> {
    let session = wcal_session::load(folder)?;
    let table = session.inputs.iter().find(|i| i.purpose == Purpose::Fit);
    table
        .map(|i| folder.join(&i.path))
        .ok_or_else(|| anyhow!("{}: expected a points table, found none", folder.display()))
}

/// What the arguments ask for, and the rig of a stream with its place.
fn source(args: &TrackArgs) -> Result<(Source, Option<(String, Rig)>)> {
    let (source, own_rig) = match &args.source {
        None => (Source::Interrogator, None),
        Some(path) if path.is_dir() => {
            if let Some(sweep) = SweepSession::of(path)? {
                return Ok((Source::Table(sweep.points), None));
            }
            if args.model.is_empty() && path.join("session.toml").is_file() {
                return Ok((
                    match args.motion {
                        Some(_) => Source::Table(points_table(path)?),
                        None => Source::Session(path.clone()),
                    },
                    None,
                ));
            }
            let parts = wcal_acquisition::reduce::recordings(path);
            if parts.is_empty() {
                bail!(
                    "{}: expected a session folder with recording.mcap, found none",
                    path.display()
                );
            }
            (Source::Recordings(parts), Some(path.join("rig.toml")))
        }
        Some(path) if path.extension().is_some_and(|e| e == "mcap") => {
            // A recording in its session's folder has the rig beside it.
            let beside = Some(path.with_file_name("rig.toml")).filter(|rig| rig.is_file());
            (Source::Recordings(vec![path.clone()]), beside)
        }
        Some(path) => return Ok((Source::Table(path.clone()), None)),
    };
    let named = args.rig.as_ref().map(|r| {
        if r.is_dir() {
            r.join("rig.toml")
        } else {
            r.clone()
        }
    });
    let file = named
        .or(own_rig)
        .ok_or_else(|| anyhow!("expected --rig RIG for a stream, found none"))?;
    let mut text = read_text(&file)?;
    if let Some(bench) = &args.bench {
        text = crate::stage_sweep::with_addresses(&text, &read_text(bench)?)
            .with_context(|| format!("addresses in {}", bench.display()))?;
    }
    let place = file.display().to_string();
    let rig = Rig::parse(&place, &text)?;
    Ok((source, Some((place, rig))))
}

/// Values of a repeated option by whisker; one without ID serves all whiskers.
fn by_whisker(
    option: &str,
    given: &[String],
    names: &[String],
) -> Result<BTreeMap<String, PathBuf>> {
    let mut all = BTreeMap::new();
    let mut common = None;
    for value in given {
        // A path may hold `=` too: only names of the rig count as an ID.
        match value
            .split_once('=')
            .filter(|(id, _)| names.iter().any(|n| n == id))
        {
            Some((id, path)) => {
                if all.insert(id.to_owned(), PathBuf::from(path)).is_some() {
                    bail!("{option}: expected one for whisker {id}, found two");
                }
            }
            None if common.is_none() => common = Some(PathBuf::from(value)),
            None => {
                bail!(
                    "{option}: expected one, or ID=... with whiskers {names:?} of the rig, found {value}"
                )
            }
        }
    }
    for name in names {
        if let Some(path) = &common {
            all.entry(name.clone()).or_insert_with(|| path.clone());
        }
        if !all.contains_key(name) {
            bail!("{option}: expected {name}=..., found none for whisker {name}");
        }
    }
    Ok(all)
}
