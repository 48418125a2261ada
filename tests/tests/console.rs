//! The console in a browser, driven as an operator drives it. Needs a Chromium and npm, so it is ignored by default;
//! `.ci/run` runs it where there is one.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use echofix_server::identity::tokens;
use echofix_tests::asking::requests;
use echofix_tests::crowd::{quarantine, shifted, street};
use echofix_tests::mapping::{contribute, folded};
use echofix_tests::service::Service;
use echofix_tests::{base_map, binary, grpc, town, until_blocking};

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

/// Who signs in, and the tokens that say so.
fn tokens(folder: &Path) -> (PathBuf, String) {
    let file = folder.join("tokens");
    let of = |role: &str| {
        let role_of = role.parse().expect("it is a role");
        (
            role.to_owned(),
            tokens::create(&file, role_of, &format!("{role}-1")).expect("a file can be written").into(),
        )
    };
    let all: serde_json::Map<_, serde_json::Value> =
        ["viewer", "operator", "admin"].map(of).into_iter().collect();
    (file.clone(), serde_json::Value::Object(all).to_string())
}

/// A street that two drove along, and three who are off by the same 1.5 m. Somebody has asked where it is.
async fn quarantined(settings: &[&str]) -> Service {
    let service = Service::start_with(settings);
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
    let mut client = grpc::localizing(&service).await;
    for asked in requests(&street(&city, 9, "gerda"), 5.0, town::seed()).into_iter().take(3) {
        client.localize(asked.request).await.expect("the question is answered");
    }
    service
}

/// Catches: a control of the console that does nothing or cannot be reached by the keyboard, a decision that is taken unasked or by
/// whoever only looks, a page that is no wider than its screen or not readable by all, one that loads from elsewhere unasked, and
/// one that shows a dead service as ready. Pictures lie in `target/tmp/console`.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs Chromium and npm"]
async fn an_operator_works_with_the_console() {
    binary::echofix();
    let folder = tempfile::tempdir().expect("a folder can be made");
    let (file, tokens) = tokens(folder.path());
    let streets = folder.path().join("streets.pmtiles");
    std::fs::write(&streets, base_map::file()).expect("a file can be written");
    let settings = [
        format!("identity.tokens={}", file.display()),
        "identity.anonymous=viewer,mapper".to_owned(),
        "mapping.publish_contributors=2".to_owned(),
        format!("http.base_map={}", streets.display()),
    ];
    let settings = settings.each_ref().map(String::as_str);
    let (work, mut service) = (script(), quarantined(&settings).await);
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR")).join("console");
    std::fs::create_dir_all(&pictures).expect("a folder can be made");
    let mut drive = Command::new("node");
    drive.arg("drive.mjs").arg(&service.http).arg(&pictures).current_dir(work).env("TOKENS", tokens);
    let mut drive = drive.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("node can be run");
    let mut stdin = drive.stdin.take().expect("it is piped");
    for line in BufReader::new(drive.stdout.take().expect("it is piped")).lines() {
        let line = line.expect("the script writes text");
        println!("{line}");
        let told = match line.as_str() {
            "end the service" => {
                service.kill();
                "ended".to_owned()
            }
            "start it again, for nobody, over tiles of another" => {
                let tiles = format!("http.base_map={}", base_map::service_of_tiles());
                let whose = "http.base_map_attribution=© Somebody https://licence.example/map";
                service.set(&["identity.anonymous=none", &tiles, whose]);
                service.start_again();
                service.http.clone()
            }
            _ => continue,
        };
        writeln!(stdin, "{told}").expect("the script waits for it");
    }
    assert!(drive.wait().expect("the script ends").success(), "see {}", pictures.display());
}
