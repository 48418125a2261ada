//! Real radar data through the command. The data is not in the repository: `ECHOFIX_DATA_DIR` names
//! the folder that holds `radiate_tiny_foggy` and `comma2k19_example`, then
//!
//! ```text
//! ECHOFIX_DATA_DIR=... cargo test -p echofix-tests --test real_radar -- --ignored
//! ```

use std::path::PathBuf;

use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use serde_json::Value;

fn data(name: &str) -> String {
    let folder =
        std::env::var_os("ECHOFIX_DATA_DIR").expect("ECHOFIX_DATA_DIR names the folder with the data");
    PathBuf::from(folder).join(name).to_str().expect("the path is Unicode").to_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// An imported set: the service to map it with, the log, the spool.
fn imported(service: Service, kind: &str, folder: &str) -> (Service, String, String) {
    let path = |name: &str| service.scratch().join(name).to_str().expect("the path is Unicode").to_owned();
    let (log, spool) = (path("drive.mcap"), path("spool"));
    let imported = echofix(["import", kind, &data(folder), &log, "--json"]).json();
    eprintln!("{imported}");
    (service, log, spool)
}

/// A spinning radar in fog: the first nine scans make the map, the next nine find themselves in it.
/// Catches a frame, a sign or a unit that the simulator and the service get wrong in the same way.
#[test]
#[ignore = "needs ECHOFIX_DATA_DIR"]
fn radiate_scans_find_themselves_in_the_map_of_the_scans_before() {
    let (service, log, spool) = imported(Service::start(), "radiate", "radiate_tiny_foggy");
    let mapped =
        echofix(["map", &log, "--server", &service.grpc, "--spool", &spool, "--scans", "1-9", "--json"])
            .json();
    eprintln!("{mapped}");
    assert!(
        number(&mapped["result"]["detections"]) > 1_000.0 && mapped["result"]["refused"] == 0,
        "{mapped}"
    );
    let localized = echofix([
        "localize",
        &log,
        "--server",
        &service.grpc,
        "--scans",
        "10-18",
        "--every-s",
        "0",
        "--batch-s",
        "5",
        "--warm-up-s",
        "0",
        "--priors",
        "50",
        "--sigma-position-m",
        "2",
        "--sigma-yaw-deg",
        "3",
        "--json",
    ])
    .json();
    let summary = &localized["summary"];
    eprintln!("{summary:#}");
    assert!(number(&summary["asked"]) >= 100.0, "{summary:#}");
    // Usable or not: the best pose is the right one.
    assert!(number(&summary["error_all_m"]["p95"]) < 0.5, "{summary:#}");
    assert!(number(&summary["error_yaw_all_deg"]["p95"]) < 1.0, "{summary:#}");
    assert_eq!(summary["beyond_protection"], 0, "{summary:#}");
}

/// A car's radar on a highway, which gives tracks of other cars and hardly any structure: movers are
/// dropped and counted, and what is left is never called usable.
#[test]
#[ignore = "needs ECHOFIX_DATA_DIR"]
fn comma2k19_movers_are_dropped_and_too_little_is_never_usable() {
    let loose = ["mapping.max_sigma_position_m=0.6", "mapping.max_sigma_yaw_deg=1"];
    let (service, log, spool) = imported(Service::start_with(&loose), "comma2k19", "comma2k19_example");
    // Its poses are known to half a metre and a degree: not well enough, unless told so.
    let arguments = ["map", &log, "--server", &service.grpc, "--spool", &spool, "--json"];
    let strict = echofix(arguments);
    assert!(strict.error().contains("without a good pose"), "{strict:?}");
    let mapped =
        echofix(arguments.iter().chain(&["--max-sigma-m", "0.6", "--max-sigma-yaw-deg", "1"])).json();
    eprintln!("{mapped}");
    let (kept, moving) =
        (number(&mapped["result"]["detections"]), number(&mapped["result"]["left_out"]["moving"]));
    // Some 8 tracks a cycle, little more than one of them stationary.
    assert!(kept > 0.0 && moving > 3.0 * kept && mapped["result"]["refused"] == 0, "{mapped}");
    let localized = echofix(["localize", &log, "--server", &service.grpc, "--every-s", "2", "--json"]).json();
    let summary = &localized["summary"];
    eprintln!("{summary:#}");
    assert!(number(&summary["asked"]) > 0.0 && number(&summary["usable_share"]).abs() < 1e-12, "{summary:#}");
}
