//! The console in a browser, driven as an operator drives it. Needs a Chromium and npm, so it is ignored by default;
//! `.ci/run` runs it where there is one.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use echofix_tests::crowd::{quarantine, shifted, street};
use echofix_tests::mapping::{contribute, folded};
use echofix_tests::service::Service;
use echofix_tests::{binary, town, until_blocking};

/// A copy of the script with its packages, beside the test's own artefacts.
fn script() -> PathBuf {
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../server/console/browser");
    let work = Path::new(env!("CARGO_TARGET_TMPDIR")).join("console-browser");
    std::fs::create_dir_all(&work).expect("a folder can be made");
    for name in ["package.json", "package-lock.json", "drive.mjs"] {
        std::fs::copy(from.join(name), work.join(name)).expect("the script is there");
    }
    let npm = Command::new("npm")
        .args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"])
        .current_dir(&work)
        .status();
    assert!(npm.expect("npm can be run").success(), "the packages cannot be had");
    work
}

/// A street that two drove along, and three who are off by the same 1.5 m.
async fn quarantined() -> Service {
    let service = Service::start();
    let city = town::town(town::seed());
    for (day, vehicle) in (0..).zip(["anna", "boris"]) {
        contribute(&service, &street(&city, day, vehicle)).await;
    }
    for (day, vehicle) in (5..).zip(["dora", "emil", "fritz"]) {
        contribute(&service, &shifted(street(&city, day, vehicle), 0.0, 1.5)).await;
    }
    folded(&service).await;
    until_blocking("there is an alarm", Duration::from_secs(20), || {
        (!quarantine(&service)["alarms"].as_array()?.is_empty()).then_some(())
    });
    service
}

/// Catches: a control of the console that does nothing, a decision that is taken unasked, a page that is no wider than its
/// screen or not readable by all, and one that shows a dead service as ready. Pictures lie in `target/tmp/console`.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Chromium and npm"]
async fn an_operator_works_with_the_console() {
    binary::echofix();
    let (work, mut service) = (script(), quarantined().await);
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR")).join("console");
    std::fs::create_dir_all(&pictures).expect("a folder can be made");
    let mut drive = Command::new("node");
    drive.arg("drive.mjs").arg(&service.http).arg(&pictures).current_dir(work);
    let mut drive = drive.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("node can be run");
    for line in BufReader::new(drive.stdout.take().expect("it is piped")).lines() {
        let line = line.expect("the script writes text");
        println!("{line}");
        if line == "end the service" {
            service.kill();
            let stdin = drive.stdin.as_mut().expect("it is piped");
            writeln!(stdin, "ended").expect("the script waits for it");
        }
    }
    assert!(drive.wait().expect("the script ends").success(), "see {}", pictures.display());
}
