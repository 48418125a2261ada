//! The map's history, as an operator sees and decides it with the command.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::time::Duration;

use echofix_tests::command::{echofix, tomorrow};
use echofix_tests::service::Service;
use echofix_tests::until_blocking;
use serde_json::Value;

/// The map in numbers, once it shows all that was decided.
fn shown(service: &Service) -> Value {
    until_blocking("the map shows what was decided", Duration::from_secs(30), || {
        let map = echofix(["status", "--http", &service.http, "--json"]).json()["map"].clone();
        (map["epoch"] == map["journaled"] && map["building"].is_null()).then_some(map)
    })
}

/// `echofix map ...` against a service.
fn operate(service: &Service, words: &[&str]) -> Value {
    let http = ["--http", &service.http, "--json"];
    echofix(["map"].iter().chain(words).chain(&http).copied()).json()
}

/// Catches a decision that is lost on the way from the command to the map, an export that does not carry the
/// map, and a backup that a service does not start on.
#[test]
fn an_operator_takes_back_brings_back_and_restores() {
    let mut service = Service::start();
    let folder = service.scratch();
    let path = |name: &str| folder.join(name).to_str().expect("the path is Unicode").to_owned();
    let (drive, spool, region, archive) = (path("a.mcap"), path("spool"), path("all.efx"), path("all.tar"));
    echofix([
        "simulate",
        &drive,
        "--day",
        "0",
        "--vehicle",
        "mapper",
        "--seed",
        "11",
        "--wander-m",
        "200",
        "--json",
    ])
    .json();
    echofix(["map", &drive, "--server", &service.grpc, "--spool", &spool, "--json"]).json();
    let mapped = shown(&service);
    assert!(mapped["totals"]["cells"].as_u64().unwrap() > 1_000, "{mapped}");
    operate(&service, &["export", &region]);

    let revoked = operate(&service, &["revoke", "--contributor", "mapper", "--yes"]);
    assert_eq!(shown(&service)["totals"]["cells"], 0, "all of it came from one contributor");
    let diff = operate(&service, &["diff", &mapped["epoch"].to_string(), &revoked["epoch"].to_string()]);
    assert_eq!(diff["cells"]["removed"], mapped["totals"]["cells"]);
    let imported = operate(&service, &["import", &region]);
    assert_eq!(shown(&service)["totals"]["cells"], mapped["totals"]["cells"]);
    assert_eq!(operate(&service, &["import", &region])["known"], imported["tiles"]);

    operate(&service, &["backup", &archive]);
    assert_eq!(fs::metadata(&archive).unwrap().permissions().mode() & 0o777, 0o600);
    let foretold = operate(&service, &["rollback", &revoked["epoch"].to_string(), "--dry-run"]);
    assert_eq!(foretold["dry_run"]["cells"]["removed"], mapped["totals"]["cells"]);
    let unasked = echofix(["map", "rollback", "0", "--http", &service.http]);
    assert!(unasked.stderr.contains("--yes"), "nobody can be asked: {}", unasked.stderr);
    operate(&service, &["rollback", &revoked["epoch"].to_string(), "--yes"]);
    assert_eq!(shown(&service)["totals"]["cells"], 0);
    let undone =
        operate(&service, &["undo", &shown(&service)["epoch"].to_string(), "--yes", "--reason", "a mistake"]);
    assert_eq!(shown(&service)["totals"]["cells"], mapped["totals"]["cells"]);
    let history = operate(&service, &["history"]);
    assert_eq!(
        (&history["events"][0]["reason"], &history["events"][1]["undone_by"]),
        (&"a mistake".into(), &undone["epoch"])
    );
    operate(&service, &["undo", &undone["epoch"].to_string(), "--yes"]);
    assert_eq!(shown(&service)["totals"]["cells"], 0);
    let kinds = |history: &Value| -> Vec<String> {
        let events = history["events"].as_array().unwrap().iter();
        events.map(|event| event["kind"].as_str().unwrap().to_owned()).collect()
    };
    let expected = ["undo", "undo", "rollback", "import", "revoke_contributor", "uploads"];
    assert_eq!(kinds(&operate(&service, &["history"])), expected);
    let found = operate(&service, &["verify", "--replay"]);
    assert_eq!(found["sound"], true, "{found}");

    service.kill();
    fs::remove_dir_all(service.data_dir()).unwrap();
    fs::create_dir(service.data_dir()).unwrap();
    let unpacked = Command::new("tar").arg("xf").arg(&archive).arg("-C").arg(service.data_dir()).status();
    assert!(unpacked.unwrap().success());
    service.start_again();
    assert_eq!(
        shown(&service)["totals"]["cells"],
        mapped["totals"]["cells"],
        "as it was before the rollback"
    );
    assert_eq!(kinds(&operate(&service, &["history"])), expected[3..]);
    let settled = operate(&service, &["compact", "--before", &tomorrow(), "--yes"]);
    assert!(settled["epoch"].is_u64(), "{settled}");
    assert_eq!(shown(&service)["totals"]["cells"], mapped["totals"]["cells"]);
}
