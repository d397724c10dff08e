//! `wcal-lab simulate --slurm` against a real Slurm on this machine (SIMULATED sweeps); where Slurm
//! cannot start it says so, and fails in CI.

use crate::not_run::not_run;
use crate::support::{PROGRAM, program, text};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Most that the daemons get to come up, and jobs to end.
const START: Duration = Duration::from_secs(20);
const JOBS: Duration = Duration::from_secs(180);

/// munged, slurmctld and slurmd of a folder of their own; they end with it.
struct Slurm {
    folder: tempfile::TempDir,
    daemons: Vec<Child>,
}

impl Drop for Slurm {
    fn drop(&mut self) {
        // In reverse: slurmd last would wait for its controller.
        for daemon in self.daemons.iter_mut().rev() {
            let _ = Command::new("kill").arg(daemon.id().to_string()).status();
            let begin = Instant::now();
            while begin.elapsed() < Duration::from_secs(5) && matches!(daemon.try_wait(), Ok(None))
            {
                std::thread::sleep(Duration::from_millis(50));
            }
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

fn until(most: Duration, mut done: impl FnMut() -> bool) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < most {
        if done() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    false
}

fn free_port() -> Result<u16, String> {
    let free = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr());
    Ok(free.map_err(|e| e.to_string())?.port())
}

impl Slurm {
    /// Why not, where it cannot.
    fn start() -> Result<Self, String> {
        let of = |c: &mut Command| {
            c.output()
                .map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned())
                .map_err(|e| e.to_string())
        };
        if of(Command::new("id").arg("-u"))? != "0" {
            return Err("Slurm's daemons start jobs as other users: this needs root".to_owned());
        }
        let host = of(&mut Command::new("hostname"))?;
        let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
        let place = |name: &str| folder.path().join(name);
        for name in ["state", "spool"] {
            std::fs::create_dir(place(name)).map_err(|e| e.to_string())?;
        }
        let key: Vec<u8> = (0..1024_u32)
            .map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        std::fs::write(place("key"), key).map_err(|e| e.to_string())?;
        let closed = |path: &Path, mode: u32| {
            use std::os::unix::fs::PermissionsExt;
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))
                .map_err(|e| e.to_string())
        };
        closed(&place("key"), 0o600)?;
        closed(folder.path(), 0o755)?;
        let at = folder.path().display();
        let conf = format!(
            "ClusterName=wcal-test\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={}\nSlurmdPort={}\n\
             SlurmUser=root\nSlurmdUser=root\nAuthType=auth/munge\nAuthInfo=socket={at}/munge.sock\n\
             CredType=cred/munge\nStateSaveLocation={at}/state\nSlurmdSpoolDir={at}/spool\n\
             SlurmctldPidFile={at}/slurmctld.pid\nSlurmdPidFile={at}/slurmd.pid\n\
             SlurmctldLogFile={at}/slurmctld.log\nSlurmdLogFile={at}/slurmd.log\n\
             ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nJobAcctGatherType=jobacct_gather/none\n\
             AccountingStorageType=accounting_storage/none\nSelectType=select/cons_tres\n\
             SelectTypeParameters=CR_Core\nSchedulerParameters=sched_interval=1,batch_sched_delay=0\n\
             MpiDefault=none\nSwitchType=switch/none\nReturnToService=2\n\
             NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN\n\
             PartitionName=test Nodes={host} Default=YES MaxTime=INFINITE State=UP\n",
            free_port()?,
            free_port()?
        );
        std::fs::write(place("slurm.conf"), conf).map_err(|e| e.to_string())?;
        let mut slurm = Self {
            folder,
            daemons: Vec::new(),
        };
        let key = format!("--key-file={}", slurm.place("key").display());
        let socket = format!("--socket={}", slurm.place("munge.sock").display());
        let pid = format!("--pid-file={}", slurm.place("munged.pid").display());
        let seed = format!("--seed-file={}", slurm.place("munge.seed").display());
        slurm.daemon("munged", &["--foreground", &key, &socket, &pid, &seed])?;
        if !until(START, || slurm.place("munge.sock").exists()) {
            return Err(format!("munged opened no socket: {}", slurm.said("munged")));
        }
        slurm.daemon("slurmctld", &["-D"])?;
        slurm.daemon("slurmd", &["-D"])?;
        let idle = || {
            let found = slurm.command("sinfo").args(["-h", "-o", "%T"]).output();
            found.is_ok_and(|o| String::from_utf8_lossy(&o.stdout).trim() == "idle")
        };
        if !until(START, idle) {
            return Err(format!(
                "the node did not become idle: {} {}",
                slurm.said("slurmctld"),
                slurm.said("slurmd")
            ));
        }
        Ok(slurm)
    }

    fn place(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.env("SLURM_CONF", self.place("slurm.conf"));
        command
    }

    fn daemon(&mut self, program: &str, args: &[&str]) -> Result<(), String> {
        let log = std::fs::File::create(self.place(&format!("{program}.out")))
            .map_err(|e| e.to_string())?;
        let mut command = self.command(program);
        let command = command
            .args(args)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log);
        self.daemons
            .push(command.spawn().map_err(|e| format!("{program}: {e}"))?);
        Ok(())
    }

    /// The last lines of a daemon.
    fn said(&self, program: &str) -> String {
        let text =
            std::fs::read_to_string(self.place(&format!("{program}.out"))).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        lines[lines.len().saturating_sub(4)..].join(" | ")
    }

    fn simulate(&self, out: &str, more: &[&str]) -> Output {
        let mut command = self.command(PROGRAM);
        let fixed = [
            "simulate",
            "--object",
            "can",
            "--object",
            "wedge",
            "--sweeps",
            "27",
            "--plan",
            "plan.toml",
            "--out",
            out,
        ];
        command
            .current_dir(self.folder.path())
            .args(fixed)
            .args(more)
            .output()
            .unwrap()
    }

    /// Waits for a submission's check job; its log and exit code, and the tasks that ran.
    fn finished(&self, json: &serde_json::Value, out: &str) -> (String, i32, usize) {
        let [array, check] =
            ["array_job", "check_job"].map(|k| json[k].as_str().unwrap().to_owned());
        let show = |job: &str| {
            let found = self
                .command("scontrol")
                .args(["show", "job", job])
                .output()
                .unwrap();
            String::from_utf8_lossy(&found.stdout).into_owned()
        };
        let ended = |text: &str| {
            ["COMPLETED", "FAILED"]
                .iter()
                .any(|s| text.contains(&format!("JobState={s}")))
        };
        assert!(
            until(JOBS, || ended(&show(&check))),
            "{}\n{}",
            show(&check),
            self.said("slurmctld")
        );
        let code = show(&check)
            .split("ExitCode=")
            .nth(1)
            .and_then(|t| t.split(':').next()?.parse().ok());
        let log = std::fs::read_to_string(self.place(out).join("slurm/check.log")).unwrap();
        (
            log,
            code.unwrap(),
            show(&array).matches("ArrayTaskId=").count(),
        )
    }
}

fn submitted(output: &Output) -> serde_json::Value {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Every table's bytes, by name.
fn tables(folder: &Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path());
    let tables = files.filter(|f| f.extension().is_some_and(|e| e == "parquet") && f.is_file());
    tables
        .map(|f| {
            (
                f.file_name().unwrap().to_string_lossy().into_owned(),
                std::fs::read(&f).unwrap(),
            )
        })
        .collect()
}

#[test]
fn a_job_array_makes_the_dataset_and_is_safe_to_submit_again() {
    let slurm = match Slurm::start() {
        Ok(slurm) => slurm,
        Err(why) => {
            not_run(format!("Slurm cannot start here: {why}"));
            return;
        }
    };
    std::fs::write(slurm.place("plan.toml"), "most_mm = 40.0\nrate_hz = 2.0\n").unwrap();
    std::fs::write(slurm.place("head.sh"), "#SBATCH --cpus-per-task=1\n").unwrap();
    let submit = ["--slurm", "head.sh", "--slurm-tasks", "3", "--json"];
    let alone = slurm.simulate("alone", &[]);
    assert_eq!(alone.status.code(), Some(0), "{}", text(&alone.stderr));

    // A task that cannot write its shard fails, and the check names what is missing (negative
    // control).
    let obstacle = slurm.place("sweeps/can-000025.samples.parquet");
    std::fs::create_dir_all(obstacle.join("in-the-way")).unwrap();
    let first = submitted(&slurm.simulate("sweeps", &submit));
    assert_eq!([&first["tasks"], &first["shards"]], [3, 4]);
    // While it is in the queue a second submission is refused.
    let second = slurm.simulate("sweeps", &submit);
    assert_eq!(second.status.code(), Some(1));
    assert!(
        text(&second.stderr).contains("earlier submission"),
        "{}",
        text(&second.stderr)
    );
    let (log, code, _) = slurm.finished(&first, "sweeps");
    assert_eq!(code, 4, "{log}");
    assert!(log.contains("can-000025 is missing"), "{log}");
    assert!(
        !log.contains("can-000000 is missing") && !log.contains("wedge-000000 is missing"),
        "{log}"
    );

    // Submitted again: what is there is passed over, a half-written shard is made again too.
    std::fs::remove_dir_all(&obstacle).unwrap();
    let whole = std::fs::read(slurm.place("sweeps/wedge-000000.samples.parquet")).unwrap();
    std::fs::write(
        slurm.place("sweeps/wedge-000000.samples.parquet"),
        &whole[..whole.len() / 2],
    )
    .unwrap();
    let untouched = slurm.place("sweeps/can-000000.json");
    let before = std::fs::metadata(&untouched).unwrap().modified().unwrap();
    let again = submitted(&slurm.simulate("sweeps", &submit));
    let (log, code, tasks) = slurm.finished(&again, "sweeps");
    assert_eq!((code, tasks), (0, 3), "{log}");
    assert_eq!(
        std::fs::metadata(&untouched).unwrap().modified().unwrap(),
        before,
        "a finished shard was made again"
    );
    assert!(
        tables(&slurm.place("sweeps")) == tables(&slurm.place("alone")),
        "one machine and the array differ"
    );
    let summary = std::fs::read_to_string(slurm.place("sweeps/dataset.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["sweeps"], 54);
    assert!(
        summary["core_h_per_15600_sweeps"].as_f64().unwrap() > 0.0,
        "{summary}"
    );
}

#[test]
fn the_scripts_are_printed_without_slurm() {
    let folder = tempfile::tempdir().unwrap();
    let header = "#SBATCH --partition=long\n#SBATCH --mem=2G\nmodule load wcal\n";
    std::fs::write(folder.path().join("head.sh"), header).unwrap();
    let given =
        "simulate --object can --sweeps 100 --slurm head.sh --dry-run --slurm-tasks 2 --out sweeps";
    let done = program()
        .current_dir(folder.path())
        .args(given.split_whitespace())
        .output()
        .unwrap();
    let scripts = text(&done.stdout);
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    for (line, times) in [
        ("#SBATCH --array=1-2", 1),
        ("#SBATCH --partition=long", 2),
        ("#SBATCH --mem=2G", 2),
        ("module load wcal", 2),
    ] {
        assert_eq!(
            scripts.lines().filter(|l| *l == line).count(),
            times,
            "{line}: {scripts}"
        );
    }
    // Slurm reads its lines up to the first one of another kind.
    let last = scripts.rfind("#SBATCH").unwrap();
    assert!(scripts.rfind("module load").unwrap() > last, "{scripts}");
    assert!(
        scripts.contains("'--out' 'sweeps' --shard \"$SLURM_ARRAY_TASK_ID/2\"\n"),
        "{scripts}"
    );
    assert!(scripts.contains("'--out' 'sweeps' --check"), "{scripts}");
    assert!(
        !folder.path().join("sweeps").exists(),
        "a dry run left something behind"
    );
    // Negative control: the options mean something only with --slurm.
    let wrong = program()
        .args([
            "simulate",
            "--object",
            "can",
            "--dry-run",
            "--out",
            "sweeps",
        ])
        .output()
        .unwrap();
    assert_eq!(wrong.status.code(), Some(2));
}
