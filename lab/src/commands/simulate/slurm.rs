//! `wcal-lab simulate --slurm`: a job array over the shards, and a job that checks and sums up once
//! all tasks ended.

use crate::dataset::Dataset;
use anyhow::{Context, bail, ensure};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::Command;
use wcal::output::write_file;

/// Version of `slurm/submission.json`.
const FORMAT: &str = "wcal-slurm/1";
/// Options of this command that the jobs do not take over; the second tells whether a value
/// follows.
const OWN: [(&str, bool); 5] = [
    ("--slurm", true),
    ("--slurm-tasks", true),
    ("--dry-run", false),
    ("--json", false),
    ("--shard", true),
];

/// Options of `wcal-lab simulate --slurm`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Slurm")]
pub struct SlurmArgs {
    /// Submit a job array over the shards, and a job that checks and sums up. HEADER begins both
    /// scripts: lines "#SBATCH --partition=long" (time, memory, account, cores: --cpus-per-task),
    /// then shell lines such as "module load". --out is a folder that all nodes share
    #[arg(long, value_name = "HEADER", conflicts_with_all = ["check", "shard"])]
    pub slurm: Option<PathBuf>,
    /// Tasks of the array
    #[arg(long, value_name = "N", default_value_t = 50, requires = "slurm")]
    pub slurm_tasks: usize,
    /// Print both scripts, submit nothing
    #[arg(long, requires = "slurm")]
    pub dry_run: bool,
}

/// What `wcal-lab simulate --slurm` handed in.
#[derive(Debug, Serialize, JsonSchema)]
pub struct Submission {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    format: &'static str,
    /// Number of the array of jobs.
    array_job: String,
    /// Number of the job that checks.
    check_job: String,
    /// Tasks of the array.
    tasks: usize,
    /// Shards in all; a task passes over those that are there.
    shards: usize,
}

/// Hands the dataset to Slurm; none where the scripts are only printed.
///
/// # Errors
/// Where an earlier submission still runs, or Slurm refuses.
pub fn submit(
    (args, header): (&SlurmArgs, &Path),
    out: &Path,
    dataset: &Dataset,
) -> anyhow::Result<Option<Submission>> {
    ensure!(
        args.slurm_tasks > 0,
        "--slurm-tasks: expected 1 or more, found 0"
    );
    let header = wcal_core::files::read_text(header)?;
    let here = std::env::current_dir().context("finding the current folder")?;
    let folder = here.join(out).join("slurm");
    let shards = dataset.shards().len();
    // More tasks than shards would do nothing.
    let tasks = args.slurm_tasks.min(shards);
    let job = Job {
        here: &here,
        folder: &folder,
        header: header.trim(),
    };
    let [array, check] = job.scripts(tasks)?;
    if args.dry_run {
        println!("# slurm/array.sh\n{array}\n# slurm/check.sh\n{check}");
        return Ok(None);
    }
    refuse_a_second(&folder)?;
    write_file(&folder.join("array.sh"), array.as_bytes())?;
    write_file(&folder.join("check.sh"), check.as_bytes())?;
    let array_job = sbatch(&[], &folder.join("array.sh"))?;
    // After any end: the check names what a failed task left out.
    let check_job = sbatch(
        &[format!("--dependency=afterany:{array_job}")],
        &folder.join("check.sh"),
    )?;
    let submission = Submission {
        format: FORMAT,
        array_job,
        check_job,
        tasks,
        shards,
    };
    write_file(
        &folder.join("submission.json"),
        serde_json::to_string_pretty(&submission)?.as_bytes(),
    )?;
    Ok(Some(submission))
}

impl Submission {
    /// For a person.
    pub fn print(&self) {
        println!(
            "job array {}: {} shards in {} tasks",
            self.array_job, self.shards, self.tasks
        );
        println!(
            "job {} checks them and writes dataset.json when all tasks have ended",
            self.check_job
        );
    }
}

/// Two arrays over one folder would make the same shards twice.
fn refuse_a_second(folder: &Path) -> anyhow::Result<()> {
    let Ok(text) = wcal_core::files::read_text(folder.join("submission.json")) else {
        return Ok(());
    };
    let last = wcal_core::document::json(&text)?;
    for job in ["array_job", "check_job"]
        .iter()
        .filter_map(|key| last[key].as_str())
    {
        let found = Command::new("squeue")
            .args(["--noheader", "--format=%i", "--jobs", job])
            .output();
        // A job that ended some minutes ago is unknown: squeue fails, and so it may.
        let queued = found.is_ok_and(|f| f.status.success() && !f.stdout.trim_ascii().is_empty());
        ensure!(
            !queued,
            "expected no job of an earlier submission to this folder in the queue, found {job}"
        );
    }
    Ok(())
}

fn sbatch(options: &[String], script: &Path) -> anyhow::Result<String> {
    let done = Command::new("sbatch")
        .arg("--parsable")
        .args(options)
        .arg(script)
        .output();
    let done = done.context("expected Slurm's sbatch on the path, could not start it")?;
    if !done.status.success() {
        bail!(
            "sbatch {}: {}",
            script.display(),
            String::from_utf8_lossy(&done.stderr).trim()
        );
    }
    // "number" or "number;cluster".
    let text = String::from_utf8_lossy(&done.stdout);
    Ok(text.trim().split(';').next().unwrap_or_default().to_owned())
}

struct Job<'a> {
    here: &'a Path,
    folder: &'a Path,
    /// What the user begins both scripts with.
    header: &'a str,
}

impl Job<'_> {
    /// Those of the array and of the check.
    fn scripts(&self, tasks: usize) -> anyhow::Result<[String; 2]> {
        let program = std::env::current_exe().context("finding this program")?;
        let words: Vec<String> = std::env::args().skip(1).collect();
        let words = [utf8(&program)?.to_owned()].into_iter().chain(kept(&words));
        let command = words.map(|w| quoted(&w)).collect::<Vec<_>>().join(" ");
        let work = format!(
            "export RAYON_NUM_THREADS=\"${{SLURM_CPUS_PER_TASK:-1}}\"\n\
             {command} --shard \"$SLURM_ARRAY_TASK_ID/{tasks}\"\n\
             code=$?\n\
             # 3: made, with objects left out by name; the check says so once more.\n\
             if [ \"$code\" -eq 3 ]; then code=0; fi\n\
             exit \"$code\"\n"
        );
        let array = format!("#SBATCH --array=1-{tasks}\n");
        Ok([
            self.head("array", &array, "task-%a.log")? + &work,
            self.head("check", "", "check.log")? + &format!("exec {command} --check\n"),
        ])
    }

    /// Lines of sbatch, this command's before the user's: Slurm reads them up to the first line of
    /// another kind.
    fn head(&self, what: &str, more: &str, log: &str) -> anyhow::Result<String> {
        // "%" introduces Slurm's own replacements in a file name.
        let log = format!("{}/{log}", utf8(self.folder)?.replace('%', "%%"));
        let here = utf8(self.here)?;
        Ok(format!(
            "#!/bin/sh\n#SBATCH --job-name=wcal-simulate-{what}\n#SBATCH --output=\"{log}\"\n#SBATCH --chdir=\"{here}\"\n\
             #SBATCH --nodes=1\n#SBATCH --ntasks=1\n{more}{}\n",
            self.header
        ))
    }
}

fn utf8(path: &Path) -> anyhow::Result<&str> {
    let text = path.to_str().filter(|t| !t.contains(['"', '\n']));
    text.with_context(|| {
        format!(
            "expected a path without quotes in UTF-8, found {}",
            path.display()
        )
    })
}

/// This command's words without the ones about Slurm and shares.
fn kept(words: &[String]) -> Vec<String> {
    let (mut out, mut skip) = (Vec::new(), false);
    for word in words {
        if skip {
            skip = false;
            continue;
        }
        let (name, value) = word
            .split_once('=')
            .map_or((word.as_str(), None), |(n, v)| (n, Some(v)));
        let own = OWN
            .iter()
            .find(|(n, _)| *n == name)
            .map(|(_, follows)| *follows);
        match own {
            Some(follows) => skip = follows && value.is_none(),
            None => out.push(word.clone()),
        }
    }
    out
}

/// For the shell, whatever it holds.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::{kept, quoted};

    #[test]
    fn the_jobs_take_over_what_is_not_about_slurm() {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let given = "simulate --object can --slurm head.sh --slurm-tasks=4 --dry-run --json --shard=1/1 --out o";
        assert_eq!(kept(&words(given)), words("simulate --object can --out o"));
        assert_eq!(quoted("it's"), "'it'\\''s'");
    }
}
