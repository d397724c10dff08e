//! Shards (SIMULATED): the same whatever the threads, taken up where they stopped, damaged ones
//! made again.

use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_lab::dataset::recipe::check_one_dataset;
use wcal_lab::dataset::{Dataset, shard};
use wcal_lab_sweeps::{SweepPlan, objects};

fn dataset(seed: u64) -> Dataset {
    Dataset {
        engine: std::sync::Arc::new(wcal_lab::dataset::RodSweeps),
        whisker: WhiskerSpec::nominal(),
        plan: SweepPlan {
            max_travel_mm: 40.0,
            rate_hz: 2.0,
            ..SweepPlan::default()
        },
        objects: ["can", "wedge"]
            .map(|n| objects::built_in(n).unwrap())
            .to_vec(),
        sweeps: 27,
        seed,
        share: [0, 1],
    }
}

/// Every table's bytes.
fn tables(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path());
    let tables = files.filter(|f| f.extension().is_some_and(|e| e == "parquet"));
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
fn shards_do_not_depend_on_threads_or_shares_and_go_on_where_they_stopped() {
    let [one, shared] = [0; 2].map(|_| tempfile::tempdir().unwrap());
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let first = pool.install(|| dataset(1).make(one.path(), |_, _| {}).unwrap());
    assert_eq!(first["can"].sweeps, 27);
    for share in 0..3 {
        Dataset {
            share: [share, 3],
            ..dataset(1)
        }
        .make(shared.path(), |_, _| {})
        .unwrap();
    }
    let whole = tables(one.path());
    assert_eq!(
        whole.len(),
        12,
        "two blocks of two objects, three tables each"
    );
    assert!(whole == tables(shared.path()));
    // A damaged table is made again, what is whole is not.
    std::fs::write(one.path().join("can-000025.samples.parquet"), b"PAR1").unwrap();
    let again = dataset(1).make(one.path(), |_, _| {}).unwrap();
    assert_eq!([again["can"].made, again["wedge"].made], [2, 0]);
    assert!(whole == tables(one.path()));
    // Negative control: another seed is another dataset.
    let other = tempfile::tempdir().unwrap();
    dataset(2).make(other.path(), |_, _| {}).unwrap();
    assert!(whole != tables(other.path()));
}

/// One folder, one dataset: what differs is named, and nothing is replaced.
#[test]
fn a_folder_takes_no_other_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let own = Dataset {
        sweeps: 2,
        ..dataset(1)
    };
    own.make(folder.path(), |_, _| {}).unwrap();
    let before = tables(folder.path());
    let refused = |other: Dataset| {
        other
            .make(folder.path(), |_, _| {})
            .unwrap_err()
            .to_string()
    };
    let plan = SweepPlan {
        rate_hz: 3.0,
        ..own.plan.clone()
    };
    let whisker = WhiskerSpec {
        youngs_gpa: 60.0,
        ..WhiskerSpec::nominal()
    };
    let objects = |names: &[&str]| {
        names
            .iter()
            .map(|n| objects::built_in(n).unwrap())
            .collect::<Vec<_>>()
    };
    let mut renamed = objects::built_in("ball").unwrap();
    renamed.name = "wedge".to_owned();
    for (other, words) in [
        (
            Dataset {
                seed: 2,
                ..own.clone()
            },
            ["seed: there 1, asked for 2", "use another folder"],
        ),
        (
            Dataset {
                plan,
                ..own.clone()
            },
            ["plan: there {", "\"rate_hz\":3.0"],
        ),
        (
            Dataset {
                whisker,
                ..own.clone()
            },
            ["whisker: there {", "60.0"],
        ),
        (
            Dataset {
                objects: objects(&["can"]),
                ..own.clone()
            },
            ["object wedge: there, not asked for", ""],
        ),
        (
            Dataset {
                objects: objects(&["can", "wedge", "ball"]),
                ..own.clone()
            },
            ["object ball: not there", ""],
        ),
        (
            Dataset {
                objects: [objects(&["can"]), vec![renamed]].concat(),
                ..own.clone()
            },
            ["object wedge: there with another mesh", ""],
        ),
    ] {
        let error = refused(other);
        assert!(
            words.iter().all(|w| error.contains(w)),
            "{words:?}: {error}"
        );
    }
    assert!(before == tables(folder.path()), "nothing was replaced");
    // A folder from before there was a recipe: its shards say as much as they can.
    std::fs::remove_file(folder.path().join("recipe.json")).unwrap();
    let error = refused(Dataset {
        seed: 2,
        ..own.clone()
    });
    assert!(error.contains("can-000000"), "{error}");
    // One of another format is compared with nothing: refused by name.
    own.make(folder.path(), |_, _| {}).unwrap();
    let recipe = folder.path().join("recipe.json");
    let now = std::fs::read_to_string(&recipe).unwrap();
    std::fs::write(
        &recipe,
        now.replace("wcal-sweep-recipe/2", "wcal-sweep-recipe/1"),
    )
    .unwrap();
    let error = refused(own.clone());
    assert!(
        error.contains("recipe/2") && error.contains("recipe/1"),
        "{error}"
    );
    std::fs::write(&recipe, now).unwrap();
    // Control: the same dataset goes on, and may grow.
    own.make(folder.path(), |_, _| {}).unwrap();
    let grown = Dataset {
        sweeps: 3,
        ..own.clone()
    }
    .make(folder.path(), |_, _| {})
    .unwrap();
    assert_eq!(grown["can"].sweeps, 3);
    // What a mixture was made of is named by whoever trains on it.
    check_one_dataset(folder.path()).unwrap();
    let other = tempfile::tempdir().unwrap();
    Dataset { seed: 2, ..own }
        .make(other.path(), |_, _| {})
        .unwrap();
    for file in std::fs::read_dir(other.path())
        .unwrap()
        .map(|f| f.unwrap().path())
    {
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("can-") {
            std::fs::copy(&file, folder.path().join(name)).unwrap();
        }
    }
    let error = check_one_dataset(folder.path()).unwrap_err().to_string();
    assert!(
        error.contains("shard can-000000") && !error.contains("wedge"),
        "{error}"
    );
}

#[test]
fn a_wrong_byte_is_found_by_the_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let make = |seed| {
        let totals = Dataset {
            sweeps: 2,
            ..dataset(seed)
        }
        .make(folder.path(), |_, _| {})
        .unwrap();
        totals
            .into_values()
            .flat_map(|t| t.again)
            .collect::<Vec<_>>()
            .join("; ")
    };
    assert_eq!(make(1), "", "the first run makes nothing again");
    let manifest = shard::read_manifest(&folder.path().join("can-000000.json")).unwrap();
    assert!(manifest.simulated && shard::check(folder.path(), &manifest).is_ok());
    let table = folder.path().join("can-000000.samples.parquet");
    let mut bytes = std::fs::read(&table).unwrap();
    bytes[100] ^= 1;
    std::fs::write(&table, bytes).unwrap();
    let error = shard::check(folder.path(), &manifest)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("can-000000.samples.parquet") && error.contains("SHA-256"),
        "{error}"
    );
    // It is made again, and that is said.
    let said = make(1);
    assert!(
        said.starts_with("can-000000: ") && said.contains("SHA-256"),
        "{said}"
    );
    assert!(shard::check(folder.path(), &manifest).is_ok() && make(1).is_empty());
}
