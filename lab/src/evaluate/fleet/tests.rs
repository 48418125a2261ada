//! Drives of simulated logs, from the command line to the tables.

use std::path::Path;

use clap::Parser;
use echofix_client::drivelog;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

use super::*;
use crate::evaluate::command::{Args, fleet_plan};

#[derive(Parser)]
struct Command {
    #[command(flatten)]
    args: Args,
}

/// What the command plans with these arguments, blanks between them.
fn plan(words: &str) -> Result<FleetPlan, clap::Error> {
    Ok(fleet_plan(&Command::try_parse_from(format!("evaluate {words}").split(' '))?.args, true))
}

/// What the command says of arguments that it refuses.
fn refusal(words: &str) -> String {
    match plan(words) {
        Ok(plan) => format!("{:#}", run(&plan).map(|_| ()).unwrap_err()),
        Err(error) => error.to_string(),
    }
}

/// Writes the log of a vehicle in a street of a town, a vehicle a day.
fn log(folder: &Path, day: u32, spoil: impl FnOnce(&mut Drive)) -> String {
    let city = City::generate(&CityParams::default()).unwrap();
    let vehicle = format!("vehicle-{day}");
    let params = DriveParams { seed: u64::from(day), vehicle, ..DriveParams::default() };
    let mut drive = simulate(&city.on_day(day), &Route::wander(&city, 3, 250.0), &params).unwrap();
    spoil(&mut drive);
    let path = folder.join(format!("day-{day}.mcap"));
    drivelog::write(&path, &drive).unwrap();
    path.display().to_string()
}

/// Catches: a drive that is asked on its own map or on nobody's, answers that belong to no region of the diagram, priors that
/// count as batches, and a log of CSV files that is not read.
#[test]
fn each_drive_is_asked_on_the_map_of_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let paths = [0, 3].map(|day| log(folder.path(), day, |_| ()));
    let tables = folder.path().join("day-5").display().to_string();
    drivelog::write(&tables, &drivelog::read(&paths[1]).unwrap().drive).unwrap();
    let rows = folder.path().join("rows.csv");
    let words = format!("--drives {} {} --priors 2 --epochs {}", paths[0], tables, rows.display());
    let report = run(&plan(&words).unwrap()).unwrap();
    let lines = report.lines.as_array().unwrap();
    let names: Vec<_> = lines.iter().map(|line| line["drive"].as_str().unwrap()).collect();
    assert_eq!(names, ["all drives", "day-0.mcap", "day-5"]);
    for line in lines {
        let tally = &line["tally"];
        let count = |name: &str| tally[name].as_u64().unwrap();
        assert!(count("batches") >= 2 && count("questions") == 2 * count("batches"), "{tally}");
        // The same street some days later: answers are good.
        assert!(count("usable") > 0 && count("wrong") == 0, "{tally}");
        let hits = line["stanford"].as_array().unwrap().iter();
        assert_eq!(hits.map(|hits| hits["answers"].as_u64().unwrap()).sum::<u64>(), count("usable"));
    }
    let questions = lines[0]["tally"]["questions"].as_u64().unwrap() as usize;
    assert_eq!(std::fs::read_to_string(rows).unwrap().lines().count(), 1 + questions);
    let figures = folder.path().join("figures");
    std::fs::create_dir_all(&figures).unwrap();
    report.section.draw(&figures).unwrap();
    assert!(figures.join("drives-stanford.svg").exists());
    assert!(report.section.text.contains("(figures/drives-stanford.svg)"));
}

/// Catches: options of the command that nothing listens to, and maps of --map that hold the wrong logs.
#[test]
fn drives_are_asked_on_the_map_that_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let [mapping, asking] = [0, 3].map(|day| log(folder.path(), day, |_| ()));
    let words = format!(
        "--drives {asking} --map {mapping} --batch-s 3 --every-s 6 --max-range-m 40 --sigma-position-m 1 --sigma-yaw-deg 2 \
         --odometry-sigma-mps 0.1 --odometry-sigma-degps 0.2 --integrity-risk 1e-5 --alert-limit-m 0.1 --seed 4"
    );
    let plan = plan(&words).unwrap();
    let QuestionPlan { every_s, batch_s, max_range_m, seed, odometry, sigma, .. } = plan.questions;
    assert_eq!((every_s, batch_s, max_range_m, seed), (6.0, 3.0, 40.0, 4));
    assert!((sigma.position_m, odometry.velocity_mps) == (1.0, 0.1));
    let report = run(&plan).unwrap();
    let all = &report.lines[0];
    let usable = all["tally"]["usable"].as_u64().unwrap();
    // No answer is bounded by 10 cm.
    assert!(usable > 0 && all["stanford"][1]["answers"] == usable, "{all}");
    assert!(report.section.text.contains("on the map of 1 other log(s)"), "{}", report.section.text);
}

/// Catches: figures without meaning from logs or arguments that cannot give any, and errors that do not say what to do.
#[test]
fn what_cannot_be_checked_is_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let good = log(folder.path(), 0, |_| ());
    let blind = log(folder.path(), 1, |drive| {
        drive.truth.clear();
        drive.reference.clear();
    });
    let vague = log(folder.path(), 2, |drive| {
        drive.reference.iter_mut().for_each(|pose| pose.sigma_position_m = 5.0);
    });
    let abroad = log(folder.path(), 4, |drive| {
        drive.truth.iter_mut().chain(&mut drive.reference).for_each(|pose| pose.at.lat_deg += 0.2);
    });
    for (words, expected) in [
        (format!("--drives {good}"), "name the logs of its map with --map"),
        (format!("--drives {good} --map {good}"), "name each log once"),
        (format!("--drives {good} {vague} --every-s 1"), "leave out --every-s"),
        (format!("--drives {blind} --map {good}"), "must hold true poses"),
        (format!("--drives {good} {blind}"), "must hold true poses"),
        (format!("--drives {good} --map {vague}"), "--max-sigma-m"),
        (format!("--drives {good} {vague}"), "the map is empty"),
        (format!("--drives {abroad} --map {good}"), "same streets"),
        (format!("--drives {good} --map {abroad} --batch-s 60"), "no batch to ask with"),
        (format!("--drives {good} --map {abroad} --integrity-risk 1"), "must lie within"),
        (format!("--drives {good} --map {abroad}/none"), "reading"),
    ] {
        let told = refusal(&words);
        assert!(told.contains(expected), "{words}: {told}");
    }
    for words in ["--drives a --drive b --map c", "--drives a --quick", "--map a", "--alert-limit-m 1"] {
        assert!(plan(words).is_err(), "{words}");
    }
}

/// Catches: two logs of one name that become one line of a table.
#[test]
fn logs_are_named_without_folders_where_that_tells_them_apart() {
    let all = ["a/x.mcap", "b/x.mcap", "b/y.mcap"].map(PathBuf::from);
    assert_eq!(all.each_ref().map(|path| name(&all, path)), ["a/x.mcap", "b/x.mcap", "y.mcap"]);
}
