//! Drive logs as they come: with flaws, mapped and localized all the same.

use std::fs;
use std::path::{Path, PathBuf};

use echofix_client::drivelog;
use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use serde_json::Value;

/// Simulates a drive as a folder of CSV files.
fn simulated(folder: &Path) -> PathBuf {
    let path = folder.join("drive");
    let arguments =
        ["simulate", &text(&path), "--wander-m", "400", "--seed", "11", "--vehicle", "flawed", "--json"];
    echofix(arguments).json();
    // Plain files, to write flaws into.
    let drive = drivelog::read(&path).expect("it was written").drive;
    let scans = path.join("scans.csv.gz");
    if scans.exists() {
        let rows: Vec<String> = drive
            .scans
            .iter()
            .flat_map(|scan| {
                (0..scan.len()).map(move |i| {
                    let speed = scan.radial_speed_mps.get(i).map(ToString::to_string).unwrap_or_default();
                    let (range, azimuth) = (scan.range_m[i], scan.azimuth_rad[i]);
                    format!("{},{},{range},{azimuth},{speed}", scan.time_us, scan.sensor)
                })
            })
            .collect();
        let header = "time_us,sensor,range_m,azimuth_rad,radial_speed_mps\n";
        fs::write(path.join("scans.csv"), format!("{header}{}\n", rows.join("\n")))
            .expect("it can be written");
        fs::remove_file(scans).expect("it can be removed");
    }
    path
}

fn text(path: &Path) -> String {
    path.to_str().expect("the path is Unicode").to_owned()
}

/// Writes flaws into the middle of a file, and cuts its last row off.
fn spoil(file: &Path, rows: impl FnOnce(&str) -> Vec<String>) {
    let content = fs::read_to_string(file).expect("it is there");
    let mut lines: Vec<&str> = content.lines().collect();
    let middle = lines.len() / 2;
    let flaws = rows(lines[middle]);
    let after = lines.split_off(middle + 1);
    lines.extend(flaws.iter().map(String::as_str).chain(after));
    let mut spoiled = lines.join("\n");
    spoiled.truncate(spoiled.len() - lines[lines.len() - 1].len() / 2);
    fs::write(file, spoiled).expect("it can be written");
}

fn count(result: &Value, part: &str, reason: &str) -> u64 {
    let skipped = result["flaws"]["skipped"].as_array().expect("flaws are told");
    let of_it = skipped.iter().filter(|skipped| skipped["part"] == part && skipped["reason"] == reason);
    of_it.map(|skipped| skipped["count"].as_u64().expect("a count")).sum()
}

/// The first cell of a row, moved by some microseconds, before the others.
fn restamped(row: &str, by_us: i64) -> String {
    let (time, rest) = row.split_once(',').expect("several cells");
    format!("{},{rest}", time.parse::<i64>().expect("a time") + by_us)
}

/// Catches: one bad row that ends a drive or takes others with it, another that is blamed for it, and drops that nobody tells.
#[test]
fn a_drive_with_flaws_maps_and_localizes_like_one_without() {
    let (folder, service) = (tempfile::tempdir().expect("a folder"), Service::start());
    let path = simulated(folder.path());
    let (log, spool) = (text(&path), text(&folder.path().join("spool")));
    let map = || echofix(["map", &log, "--server", &service.grpc, "--spool", &spool, "--json"]).json();
    let clean = map();
    let day = 86_400_000_000;
    spoil(&path.join("scans.csv"), |row| {
        let (time, _) = row.split_once(',').expect("several cells");
        vec![
            row.to_owned(),
            "\"garbage \0 in the middle".to_owned(),
            format!("{time},0,NaN,NaN,NaN"),
            format!("{time},99,5,0.1,"),
            restamped(row, -day),
            restamped(row, day),
        ]
    });
    spoil(&path.join("odometry.csv"), |row| vec![row.to_owned(), restamped(row, -day), "#".to_owned()]);
    spoil(&path.join("reference.csv"), |row| {
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[1] = "200";
        vec![row.to_owned(), cells.join(","), restamped(row, day)]
    });
    let spoiled = map();
    let result = &spoiled["result"];
    for (part, reason, least) in [
        ("scans.csv", "doubled", 1),
        ("scans.csv", "unreadable", 1),
        ("scans.csv", "not_finite", 1),
        ("scans.csv", "unknown_sensor", 1),
        ("scans.csv", "out_of_order", 2),
        ("odometry.csv", "doubled", 1),
        ("odometry.csv", "out_of_order", 1),
        ("odometry.csv", "unreadable", 1),
        ("reference.csv", "doubled", 1),
        ("reference.csv", "out_of_range", 1),
        ("reference.csv", "out_of_order", 1),
    ] {
        assert!(count(result, part, reason) >= least, "{part} {reason}: {:#}", result["flaws"]);
    }
    let detections = |mapped: &Value| mapped["result"]["detections"].as_f64().expect("a number");
    let (before, after) = (detections(&clean), detections(&spoiled));
    assert!((after / before - 1.0).abs() < 0.01, "{before} detections without flaws, {after} with");

    let localized = echofix(["localize", &log, "--server", &service.grpc, "--every-s", "5", "--json"]).json();
    let summary = &localized["summary"];
    assert!(summary["usable_share"].as_f64().expect("a share") > 0.5, "{summary:#}");
    assert!(count(&localized, "scans.csv", "not_finite") >= 1, "{:#}", localized["flaws"]);
    assert!(count(&localized, "scans.csv", "out_of_order") >= 2, "{:#}", localized["flaws"]);

    // For people: each reason with the first place.
    let told = echofix(["map", &log, "--server", &service.grpc, "--spool", &spool]);
    assert!(told.code == Some(0) && told.stdout.contains("first at odometry.csv:"), "{told:?}");
    assert!(told.stdout.contains("the service had already"), "{told:?}");
}
