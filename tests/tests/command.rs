//! The `echofix` command, as people and scripts use it.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use echofix_client::drivelog;
use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use echofix_tests::{binary, until_blocking};
use serde_json::Value;
use tempfile::TempDir;

/// More than a service takes to start, or to end.
const SOON: Duration = Duration::from_secs(30);

/// A folder and the words of a path in it.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder can be made"))
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().expect("the path is Unicode").to_owned()
    }
}

/// A simulated drive of the default town.
fn simulated(out: &str, day: &str, vehicle: &str, wander_m: &str) -> Value {
    let seed = if vehicle == "lost" { "12" } else { "11" };
    echofix([
        "simulate",
        out,
        "--day",
        day,
        "--vehicle",
        vehicle,
        "--seed",
        seed,
        "--wander-m",
        wander_m,
        "--json",
    ])
    .json()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// Catches a log that one subcommand writes and another cannot read, in either format, and figures
/// that are not those of the service.
#[test]
fn a_drive_is_simulated_mapped_and_localized_in_either_format() {
    let (folder, service) = (Folder::new(), Service::start());
    let spool = folder.path("spool");
    // The same way on the same day is driven twice: what one vehicle mapped, the other finds.
    let (mcap, csv) = (folder.path("mapper.mcap"), folder.path("visit"));
    let written = simulated(&mcap, "0", "mapper", "500");
    let visit = simulated(&csv, "0", "found", "500");
    assert!(
        number(&written["travelled_m"]) > 450.0 && number(&written["detections"]) > 50_000.0,
        "{written}"
    );
    assert_eq!((&written["vehicle"], &visit["vehicle"]), (&"mapper".into(), &"found".into()));
    assert!(
        PathBuf::from(&csv).join("scans.csv").exists() || PathBuf::from(&csv).join("scans.csv.gz").exists()
    );

    let mapped = echofix(["map", &mcap, "--server", &service.grpc, "--spool", &spool, "--json"]).json();
    let uploads = number(&mapped["result"]["uploads"]);
    assert!(uploads >= 5.0 && mapped["result"]["refused"] == 0, "{mapped}");
    let status = echofix(["status", "--http", &service.http, "--json"]).json();
    assert_eq!(status["readiness"]["ready"], true);
    assert_eq!(status["map"]["totals"]["uploads"], mapped["result"]["uploads"]);

    let fixes_csv = folder.path("fixes.csv");
    let localized = echofix([
        "localize",
        &csv,
        "--server",
        &service.grpc,
        "--every-s",
        "3",
        "--out",
        &fixes_csv,
        "--json",
    ])
    .json();
    let (summary, fixes) = (&localized["summary"], localized["fixes"].as_array().unwrap());
    assert!(fixes.len() >= 10 && summary["asked"] == fixes.len(), "{summary}");
    assert!(number(&summary["usable_share"]) > 0.6, "{summary}");
    assert!(
        number(&summary["error_m"]["p50"]) < 0.3 && number(&summary["error_m"]["p95"]) < 0.5,
        "{summary}"
    );
    assert_eq!(summary["beyond_protection"], 0, "{summary}");
    assert_eq!(fs::read_to_string(&fixes_csv).unwrap().lines().count(), fixes.len() + 1);

    // The same without the service, from the tiles that it sent.
    let tiles = folder.path("tiles");
    echofix(["tiles", "sync", &tiles, "--server", &service.grpc, "--json"]).json();
    let asked = ["localize", &csv, "--offline", &tiles, "--every-s", "3", "--json"];
    let offline = echofix(asked).json();
    let alike = |fix: &Value| {
        let of = |key: &str| fix[key].clone();
        ["time_us", "outcome", "latitude_deg", "longitude_deg", "yaw_rad", "protection_along_m"].map(of)
    };
    let offline = offline["fixes"].as_array().unwrap();
    assert!(offline.iter().map(alike).eq(fixes.iter().map(alike)), "{offline:?}\n{fixes:?}");
    // And from what a vehicle needs of them.
    let layer = folder.path("layer");
    let kept = echofix(["tiles", "sync", &layer, "--layer", "--server", &service.grpc, "--json"]).json();
    let whole = echofix(["tiles", "sync", &tiles, "--server", &service.grpc, "--json"]).json();
    assert_eq!(kept["folder"]["tiles"], whole["folder"]["tiles"]);
    assert!(number(&kept["bytes"]) * 4.0 < number(&whole["folder"]["bytes"]), "{kept} of {whole}");
    let small = echofix(["localize", &csv, "--offline", &layer, "--every-s", "3", "--json"]).json();
    let small = &small["summary"];
    assert!(number(&small["usable_share"]) > 0.6 && number(&small["error_m"]["p95"]) < 0.5, "{small}");
    assert_eq!(small["beyond_protection"], 0, "{small}");
    let strict = echofix(["localize", &csv, "--offline", &tiles, "--every-s", "10", "--fail-under", "1.0"]);
    let all = strict.stdout.contains("questions: USABLE");
    assert!(strict.code == Some(1) && strict.stderr.contains("usable") || all, "{strict:?}");
    let nowhere = echofix(["localize", &csv, "--offline", &folder.path("nowhere")]);
    assert!(nowhere.code == Some(1) && nowhere.stderr.contains("tiles sync"), "{nowhere:?}");

    // One of them as a picture.
    let page = folder.path("fix.html");
    let inspected = echofix([
        "localize",
        &csv,
        "--offline",
        &tiles,
        "--every-s",
        "3",
        "--inspect",
        "2",
        "--out",
        &page,
        "--json",
    ]);
    let drawn = fs::read_to_string(&page).unwrap_or_else(|error| panic!("{error}: {inspected:?}"));
    let outcome = fixes[1]["outcome"].as_str().unwrap();
    assert!(
        drawn.contains(&format!("question 2: {outcome}")) && drawn.contains("class=\"map\""),
        "{inspected:?}"
    );
    assert!(outcome != "USABLE" || drawn.contains("<ellipse"), "a usable fix has levels");
    let batch = drawn.split("class=\"batch\"").nth(1).unwrap().split("/>").next().unwrap();
    assert!(batch.matches('M').count() > 50, "the batch is drawn");
    let unfit =
        echofix(["localize", &csv, "--offline", &tiles, "--inspect", "2", "--out", &folder.path("fix.csv")]);
    assert!(unfit.error().contains(".html"), "{unfit:?}");

    // Once more for people: no JSON, the same counts.
    let text = echofix(["localize", &csv, "--server", &service.grpc, "--every-s", "10"]);
    assert!(text.code == Some(0) && text.stdout.contains("questions: "), "{text:?}");
}

/// Catches: an argument that hangs the command or makes it compute nothing for minutes, and a log that is written over.
#[test]
fn numbers_that_make_no_sense_are_refused_and_logs_are_kept() {
    let folder = Folder::new();
    let log = folder.path("drive.mcap");
    for (command, argument, value) in [
        ("localize", "--at-once", "0"),
        ("localize", "--batch-s", "nan"),
        ("localize", "--sigma-position-m", "-1"),
        ("localize", "--max-range-m", "inf"),
        ("map", "--max-sigma-m", "0"),
        ("simulate", "--wander-m", "nan"),
        ("simulate", "--wander-m", "1e300"),
    ] {
        let run = echofix([command, &log, &format!("{argument}={value}")]);
        assert!(run.code == Some(2) && run.stderr.contains("must lie within"), "{argument} {value}: {run:?}");
    }
    fs::write(&log, "a log of somebody").unwrap();
    let run = echofix(["simulate", &log, "--wander-m", "60"]);
    assert!(run.code == Some(1) && run.stderr.contains("--force"), "{run:?}");
    assert_eq!(fs::read_to_string(&log).unwrap(), "a log of somebody");
}

/// Catches: a log that cannot be read and takes the others with it.
#[test]
fn what_is_good_of_several_logs_is_mapped() {
    let (folder, service) = (Folder::new(), Service::start());
    let (good, bad) = (folder.path("good.mcap"), folder.path("bad.mcap"));
    simulated(&good, "0", "mapper", "150");
    fs::write(&bad, "no log").unwrap();
    let spool = folder.path("spool");
    let run = echofix(["map", &bad, &good, "--server", &service.grpc, "--spool", &spool, "--json"]);
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("1 of 2 drives") && run.stderr.contains("bad.mcap"), "{run:?}");
    assert!(run.stdout.contains("\"uploads\":"), "{run:?}");
}

/// Catches a format that loses something: both hold the same drive.
#[test]
fn mcap_and_csv_hold_the_same_drive() {
    let folder = Folder::new();
    let (mcap, csv) = (folder.path("drive.mcap"), folder.path("drive"));
    simulated(&mcap, "1", "twin", "120");
    simulated(&csv, "1", "twin", "120");
    let (one, other) = (drivelog::read(&mcap).unwrap().drive, drivelog::read(&csv).unwrap().drive);
    assert!(one == other && one.scans.len() > 500);
}

/// Catches a range of scans that is not applied.
#[test]
fn only_the_scans_asked_for_are_mapped() {
    let (folder, service) = (Folder::new(), Service::start());
    let (log, spool) = (folder.path("drive.mcap"), folder.path("spool"));
    simulated(&log, "0", "mapper", "200");
    let map = |scans: &str| {
        let run =
            echofix(["map", &log, "--server", &service.grpc, "--spool", &spool, "--scans", scans, "--json"]);
        number(&run.json()["result"]["detections"])
    };
    let (part, other_part, both) = (map("500-700"), map("701-900"), map("500-900"));
    assert!(
        part > 0.0 && other_part > 0.0 && (part + other_part - both).abs() < 0.5,
        "{part} {other_part} {both}"
    );
}

/// Catches an error that ends with the wrong code, on the wrong stream, or without saying what to do.
#[test]
fn errors_say_what_to_do_and_end_with_exit_code_one() {
    let folder = Folder::new();
    let (log, spool, notes) = (folder.path("drive.mcap"), folder.path("spool"), folder.path("notes.txt"));
    simulated(&log, "0", "mapper", "60");
    fs::write(&notes, "not a drive").unwrap();
    // Nobody listens at port 1.
    let nobody = "http://127.0.0.1:1";
    let (empty, other) = (folder.path("empty"), folder.path("other.mcap"));
    fs::create_dir(&empty).unwrap();
    for (arguments, hints) in [
        (vec!["status", "--http", nobody], vec![nobody, "echofix serve"]),
        (vec!["localize", &log, "--server", "127.0.0.1"], vec!["http://host:port"]),
        (vec!["map", &notes, "--server", nobody, "--spool", &spool], vec![&notes]),
        (vec!["map", &empty, "--server", nobody, "--spool", &spool], vec![&empty, "scans.csv", ".mcap"]),
        (vec!["localize", "/nowhere/at.all", "--server", nobody], vec!["/nowhere/at.all", "No such file"]),
        (vec!["import", "radiate", &empty, &other], vec!["missing", "radiate"]),
        (vec!["import", "radiate", &empty, &log], vec![&log, "--force"]),
        (vec!["serve", "--set", "mapping.max_rnge_m=3"], vec!["max_rnge_m", "mapping.max_range_m"]),
        (vec!["serve", "--set", "mapping.max_range_m=-3"], vec!["mapping.max_range_m"]),
    ] {
        let run = echofix(&arguments);
        let said = run.error().to_lowercase();
        for hint in hints {
            assert!(said.contains(&hint.to_lowercase()), "{arguments:?} does not say `{hint}`: {said}");
        }
    }
}

/// Catches a range or an option that is taken for something else. Arguments that cannot be read end
/// with code 2, as everywhere.
#[test]
fn arguments_that_cannot_be_read_are_told_with_what_is_expected() {
    for (arguments, hint) in [
        (vec!["map", "drive.mcap", "--scans", "9-1"], "10-18"),
        (vec!["map", "drive.mcap", "--scans", "all"], "10-18"),
        (vec!["map"], "DRIVES"),
        (vec!["import", "oxford", "a", "b"], "radiate"),
        (vec!["localise"], "localize"),
    ] {
        let run = echofix(&arguments);
        assert_eq!((run.code, run.stdout.as_str()), (Some(2), ""), "{arguments:?}: {run:?}");
        assert!(run.stderr.contains(hint), "{arguments:?} does not say `{hint}`: {}", run.stderr);
    }
}

/// Catches a service that outlives the demo that started it, when the demo is killed.
#[test]
fn a_service_may_end_with_whoever_started_it() {
    let folder = Folder::new();
    let (data, addresses) = (folder.path("data"), folder.path("addresses.json"));
    let mut service = Command::new(binary::echofix())
        .args(["serve", "--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0", "--data-dir", &data])
        .args(["--addr-file", &addresses, "--end-with-stdin"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    until_blocking("the service listens", SOON, || fs::exists(&addresses).unwrap().then_some(()));
    assert!(service.try_wait().unwrap().is_none());
    drop(service.stdin.take());
    let status = until_blocking("the service ends", SOON, || service.try_wait().unwrap());
    assert!(status.success(), "{status}");
}
