//! A street is rebuilt: those who come later agree that it is not what the map shows, an alarm is raised, and an operator decides.

use echofix_proto::v1::{FixStatus, LocalizeRequest};
use echofix_sim::City;
use echofix_tests::crowd::{bytes, quarantine, street};
use echofix_tests::mapping::{contribute, folded};
use echofix_tests::service::Service;
use echofix_tests::{asking, command, grpc, tiles, town};
use serde_json::{Value, json};

/// `echofix map ...` against a service, in words.
fn operate(service: &Service, words: &[&str]) -> String {
    let run = command::echofix(["map"].iter().chain(words).chain(&["--http", &service.http]).copied());
    assert_eq!(run.code, Some(0), "{run:?}");
    run.stdout
}

/// What a visitor of the street asks.
fn visit(city: &City) -> Vec<LocalizeRequest> {
    asking::requests(&street(city, 20, "visitor"), 8.0, 5).into_iter().map(|case| case.request).collect()
}

/// How many of these questions get an answer to use.
async fn usable(service: &Service, questions: &[LocalizeRequest]) -> usize {
    let mut client = grpc::localizing(service).await;
    let mut usable = 0;
    for question in questions {
        let answer = client.localize(question.clone()).await.map(tonic::Response::into_inner);
        usable += usize::from(answer.is_ok_and(|fix| fix.status() == FixStatus::Usable));
    }
    usable
}

fn changed(report: &Value) -> Vec<&Value> {
    let alarms = report["alarms"].as_array().expect("alarms are a list");
    alarms.iter().filter(|alarm| alarm["kind"] == "CHANGED").collect()
}

/// Catches: a street that is rebuilt and raises no alarm, one that replaces the map by itself, a decision that does not bring the new
/// street onto the map, or that cannot be undone.
#[tokio::test(flavor = "multi_thread")]
async fn a_rebuilt_street_raises_an_alarm_and_an_operator_decides() {
    let service = Service::start();
    let (before, after) = (town::town(town::seed()), town::town(town::seed() + 1));
    let (of_before, of_after) = (visit(&before), visit(&after));
    for (day, vehicle) in (0..).zip(["anna", "boris"]) {
        contribute(&service, &street(&before, day, vehicle)).await;
    }
    let known = usable(&service, &of_before).await;
    assert!(known > 0, "the street is known");
    for (day, vehicle) in (5..).zip(["dora", "emil", "fritz"]) {
        assert_eq!(changed(&quarantine(&service)).len(), 0, "{vehicle} comes to those who are too few");
        contribute(&service, &street(&after, day, vehicle)).await;
    }

    let report = quarantine(&service);
    let alarms = changed(&report);
    assert!(!alarms.is_empty() && alarms.iter().all(|alarm| alarm["contributors"] == 3), "{report:#}");
    // Nothing follows by itself: the old street is the map, and fixes in the new one are hardly to be used.
    assert_eq!(usable(&service, &of_before).await, known);
    let (served, lost) = (tiles::all(&service).await, usable(&service, &of_after).await);
    let told = operate(&service, &["quarantine"]);
    assert!(
        told.contains("ALARM: 3 contributors agree") && told.contains("something else than the map"),
        "{told}"
    );

    // Somebody went there and looked: the old street no longer counts.
    let revoke = |vehicle: &'static str, how: &'static [&'static str]| {
        operate(&service, &[&["revoke", "--contributor", vehicle][..], how].concat())
    };
    let foretold: Value = serde_json::from_str(&revoke("anna", &["--dry-run", "--json"])).expect("JSON");
    assert!(foretold["dry_run"]["uploads"]["taken_back"].as_u64() > Some(0), "{foretold}");
    for vehicle in ["anna", "boris"] {
        revoke(vehicle, &["--yes", "--reason", "the street was rebuilt"]);
    }
    folded(&service).await;
    assert_eq!(quarantine(&service)["alarms"], json!([]), "the alarm is over");
    let found = usable(&service, &of_after).await;
    assert!(found > lost, "the new street is the map: {found} fixes to use, {lost} before");
    let history = operate(&service, &["history"]);
    assert!(history.matches("\"the street was rebuilt\"").count() == 2, "{history}");

    // It was another street.
    let history: Value = serde_json::from_str(&operate(&service, &["history", "--json"])).expect("JSON");
    for decision in [0, 1].map(|event| history["events"][event]["last"].to_string()) {
        operate(&service, &["undo", &decision, "--yes", "--reason", "it was another street"]);
    }
    folded(&service).await;
    assert!(!changed(&quarantine(&service)).is_empty(), "the alarm is back");
    assert!(bytes(&tiles::all(&service).await) == bytes(&served), "the map is as it was");
}
