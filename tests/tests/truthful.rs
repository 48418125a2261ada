//! The command tells the truth: what was acknowledged, what failed, and what it will do.

use std::fs;
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use echofix_tests::{binary, until_blocking};
use serde_json::Value;
use tempfile::TempDir;

/// Nobody listens at port 1.
const NOBODY: &str = "http://127.0.0.1:1";

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().expect("the path is Unicode").to_owned()
}

fn simulated(folder: &TempDir) -> String {
    let log = path(folder, "drive.mcap");
    echofix(["simulate", &log, "--wander-m", "200", "--seed", "11", "--json"]).json();
    log
}

/// Catches: a log that is mapped twice and counts twice, and uploads of an earlier run that are counted as the drive's own.
#[test]
fn a_log_that_is_mapped_again_counts_once() {
    let (folder, service) = (tempfile::tempdir().unwrap(), Service::start());
    let (log, spool) = (simulated(&folder), path(&folder, "spool"));
    // Without a service: everything stays in the spool, and the command fails soon.
    let gone = echofix(["map", &log, "--server", NOBODY, "--spool", &spool, "--patience-s", "1", "--json"]);
    assert_eq!(gone.code, Some(1), "{gone:?}");
    let error: Value = serde_json::from_str(gone.stdout.lines().last().unwrap()).unwrap();
    let message = error["error"]["message"].as_str().unwrap();
    assert!(message.contains("0 of ") && message.contains("times: "), "{message}");
    assert!(message.contains(&spool), "{message}");
    let first_lines = gone.stderr.lines().filter(|line| line.contains("unreachable")).count();
    assert!(gone.stderr.lines().count() <= 3, "each error once: {first_lines} {}", gone.stderr);

    let map = || echofix(["map", &log, "--server", &service.grpc, "--spool", &spool, "--json"]).json();
    let (first, again) = (map(), map());
    let (first, again) = (&first["result"], &again["result"]);
    // The same ids: what lay in the spool is the drive's own.
    assert_eq!(first["uploads"], first["recorded"], "{first:#}");
    assert_eq!((&first["duplicates"], &again["duplicates"]), (&0.into(), &first["uploads"]), "{again:#}");
    assert_eq!(again["uploads"], first["uploads"]);
    let status = echofix(["status", "--http", &service.http, "--json"]).json();
    assert_eq!(status["map"]["totals"]["uploads"], first["uploads"]);
    // A map of one contributor is served by the services of these tests; the table for people says what there is.
    let table = echofix(["status", "--http", &service.http]).stdout;
    assert!(table.contains("cells served") && !table.contains('{'), "{table}");
}

/// Catches: a command that sends what nobody wants although it was told to ask, one that leaves out what is wanted, and one that
/// does not say what it left out.
#[test]
fn only_what_is_wanted_is_sent_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start_with(&["mapping.enough_passes=1", "mapping.refresh_days=14"]);
    let (log, spool) = (simulated(&folder), path(&folder, "spool"));
    let map = |more: &[&str]| {
        let usual = ["map", &log, "--server", &service.grpc, "--spool", &spool];
        echofix(usual.iter().chain(more))
    };
    let result = |more: &[&str]| map(&[more, &["--json"]].concat()).json()["result"].take();
    let first = result(&["--wanted-only"]);
    assert_eq!(first["not_wanted"], 0, "nothing is known yet: {first:#}");
    assert_eq!(first["uploads"], first["recorded"], "{first:#}");
    let again = result(&["--wanted-only", "--contributor", "another"]);
    assert_eq!(again["not_wanted"], first["recorded"], "{again:#}");
    assert_eq!((&again["uploads"], &again["recorded"]), (&0.into(), &0.into()), "{again:#}");
    let told = map(&["--wanted-only"]).stdout;
    let count = first["recorded"].to_string();
    assert!(
        told.contains(&format!("{count} uploads were not made")) && told.contains("--wanted-only"),
        "{told}"
    );
    let all = result(&["--contributor", "another"]);
    assert_eq!((&all["uploads"], &all["not_wanted"]), (&first["recorded"], &0.into()), "{all:#}");
}

/// Catches: an interrupted command that does not say how far it came, or leaves something behind.
#[test]
fn an_interrupted_run_says_how_far_it_came() {
    let folder = tempfile::tempdir().unwrap();
    let (log, spool) = (simulated(&folder), path(&folder, "spool"));
    let mut run = Command::new(binary::echofix())
        .args(["map", &log, "--server", NOBODY, "--spool", &spool, "--patience-s", "600"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The first error is told at once; by then the command waits.
    let mut told = [0; 1];
    run.stderr.as_mut().unwrap().read_exact(&mut told).unwrap();
    assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
    let status = until_blocking("the command ends", Duration::from_mins(1), || run.try_wait().unwrap());
    let mut rest = String::new();
    run.stderr.as_mut().unwrap().read_to_string(&mut rest).unwrap();
    assert_eq!(status.code(), Some(1), "{rest}");
    assert!(rest.contains("interrupted: 0 of ") && rest.contains("sent by the next run"), "{rest}");
}

/// Catches: a folder of something else that is taken for tiles or for a store, and filled.
#[test]
fn folders_of_something_else_are_refused() {
    let (folder, service) = (tempfile::tempdir().unwrap(), Service::start());
    let home = path(&folder, "home");
    fs::create_dir(&home).unwrap();
    fs::write(folder.path().join("home/letters.txt"), "dear").unwrap();
    let sync = echofix(["tiles", "sync", &home, "--server", &service.grpc]);
    assert!(sync.error().contains("letters.txt"), "{sync:?}");
    let listen = ["--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"];
    let serve = echofix(["serve", "--data-dir", &home].iter().chain(&listen));
    assert!(serve.code == Some(1) && serve.stderr.contains("letters.txt"), "{serve:?}");
    let left: Vec<_> = fs::read_dir(&home).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["letters.txt"]);
}

/// Catches: a shell, a manual or a bug report that knows nothing of the command.
#[test]
fn completions_manual_and_version_are_there() {
    for shell in ["bash", "zsh", "fish"] {
        let script = echofix(["completions", shell]);
        assert!(script.code == Some(0) && script.stdout.contains("localize"), "{shell}");
    }
    let page = echofix(["man"]);
    assert!(
        page.code == Some(0) && page.stdout.starts_with(".ie") && page.stdout.contains("echofix"),
        "{page:?}"
    );
    let folder = tempfile::tempdir().unwrap();
    let pages = path(&folder, "man1");
    assert_eq!(echofix(["man", &pages]).code, Some(0));
    assert!(folder.path().join("man1/echofix-map.1").exists());
    let version = echofix(["--version"]).stdout;
    assert!(
        version.starts_with("echofix ") && version.contains('(') && version.trim().ends_with(')'),
        "{version}"
    );
}

/// Catches: errors in words only where a machine listens.
#[test]
fn errors_are_json_where_it_is_asked_for() {
    let run = echofix(["localize", "/nowhere/at.all", "--json"]);
    let error: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(run.code, Some(1));
    assert!(error["error"]["message"].as_str().unwrap().contains("/nowhere/at.all"), "{error}");
    assert!(error["error"]["causes"][0].as_str().unwrap().contains("No such file"), "{error}");
    // Arguments that cannot be read end with code 2, as everywhere.
    for (arguments, words) in [
        (&["map", "a.mcap", "--patience-s", "nan"][..], "must lie within"),
        (&["localize"], "required arguments"),
        (&["nothing"], "unrecognized subcommand"),
        (&["simulate", "x.mcap", "--day", "-1"], "unexpected argument"),
    ] {
        let run = echofix(arguments.iter().chain(&["--json"]));
        let error: Value = serde_json::from_str(&run.stdout).unwrap_or_else(|_| panic!("{run:?}"));
        let message = error["error"]["message"].as_str().unwrap();
        assert!(run.code == Some(2) && message.contains(words), "{run:?}");
        assert!(!message.starts_with("error") && run.stderr.contains("error: "), "{run:?}");
    }
    let help = echofix(["map", "--help", "--json"]);
    assert!(help.code == Some(0) && help.stdout.contains("Usage:"), "{help:?}");
}

/// Catches: an interrupted command that leaves a part with the name of a whole, or one that cannot be begun again for it.
#[test]
fn what_is_interrupted_leaves_no_part() {
    for out in ["long.mcap", "long"] {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Command::new(binary::echofix())
            .args(["simulate", &path(&folder, out), "--wander-m", "1000000"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        until_blocking("it is under way", Duration::from_mins(1), || {
            // It hears signals once it has its handler: SIGINT is the second bit.
            let status = fs::read_to_string(format!("/proc/{}/status", run.id())).ok()?;
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"))?;
            (u64::from_str_radix(caught.trim(), 16).ok()? & 2 == 2).then_some(())
        });
        assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
        let status = until_blocking("the command ends", Duration::from_mins(1), || run.try_wait().unwrap());
        let mut told = String::new();
        run.stderr.as_mut().unwrap().read_to_string(&mut told).unwrap();
        assert_eq!((status.code(), told.trim()), (Some(1), "error: interrupted"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
    }
}

/// Catches: a panic that is told to whoever reads only the first lines.
#[test]
fn a_reader_may_leave_early() {
    let service = Service::start();
    for arguments in
        [&["status", "--http", &service.http][..], &["map", "history", "--json", "--http", &service.http]]
    {
        let mut run = Command::new(binary::echofix())
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(run.stdout.take());
        let ended = run.wait_with_output().unwrap();
        assert_eq!((ended.status.code(), &ended.stderr[..]), (Some(141), &b""[..]), "{arguments:?}");
    }
}
