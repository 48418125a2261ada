//! What a service tells of itself: what runs, each call where that is asked for, and what a listener missed.

use std::time::Duration;

use echofix_tests::http::{Events, get, get_with, post, send};
use echofix_tests::service::Service;
use echofix_tests::{grpc, mapping, town, until_blocking};

const PATIENCE: Duration = Duration::from_secs(20);

/// Catches: a log that does not say what runs, tells a secret, or holds control characters for a terminal that is none.
#[test]
fn the_first_line_says_what_runs_and_no_secret() {
    let service = Service::start_with(&["rates.localize_per_s=7", "http.hosts=[\"maps.example\"]"]);
    let log = service.log();
    assert!(!log.contains('\u{1b}'), "{log}");
    let lines: Vec<_> = log.lines().filter(|line| line.contains("listening")).collect();
    let [line] = lines[..] else { panic!("one line says what runs:\n{log}") };
    assert!(line.contains("INFO"), "{line}");
    let (grpc, http) =
        (service.grpc.trim_start_matches("http://"), service.http.trim_start_matches("http://"));
    let version = format!("version=\"{}\"", env!("CARGO_PKG_VERSION"));
    let data_dir = service.data_dir().display().to_string();
    let differing = ["rates.localize_per_s=7", "maps.example", "mapping.publish_contributors=1"];
    for part in [&version, "commit=\"", grpc, http, &data_dir].into_iter().chain(differing) {
        assert!(line.contains(part), "{part}: {line}");
    }
    assert!(!line.contains("alarms.") && !line.contains("log.filter"), "only what differs: {line}");
}

/// Catches: a call without its line, a line with a name or a position, and one that nobody asked for.
#[tokio::test(flavor = "multi_thread")]
async fn each_call_has_one_line_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens");
    let token = echofix_server::identity::tokens::create(&file, "viewer".parse().unwrap(), "anna-1").unwrap();
    let tokens = format!("identity.tokens={}", file.display());
    let service = Service::start_with(&[&tokens, "log.access=true", "log.filter=warn", "log.format=json"]);
    let bearer = format!("Bearer {token}");
    let ask = |method: &str, path: &str, id: &str, headers: &[(&str, &str)]| {
        let headers = [headers, &[("x-request-id", id)]].concat();
        send(method, &format!("{}{path}", service.http), &headers)
    };
    let known = [("authorization", &*bearer)];
    let map = ask("GET", "/api/v1/map", "req-map", &known);
    ask("GET", "/api/v1/tiles/at?lat=48.137154&lon=11.575382", "req-at", &known);
    ask("GET", "/api/v1/map/backup", "req-backup", &known);
    ask("GET", "/nowhere/anna-1", "req-nowhere", &[]);
    ask("GET", "/api/v1/map", "req-unknown", &[]);
    let visit = town::wander(&town::town(town::seed()), 3, "visitor", town::seed(), 150.0);
    let request = echofix_tests::asking::requests(&visit, 1.0, town::seed()).remove(3).request;
    let mut request = tonic::Request::new(request);
    request.metadata_mut().insert("x-request-id", "req-localize".parse().unwrap());
    grpc::localizing(&service).await.localize(request).await.expect_err("nobody knows the caller");

    let line = |id: &str| -> serde_json::Value {
        let log = until_blocking("the call is told", PATIENCE, || {
            let log = service.log();
            log.contains(id).then_some(log)
        });
        let of_call: Vec<_> = log.lines().filter(|line| line.contains(id)).collect();
        let [line] = of_call[..] else { panic!("one line tells of {id}:\n{log}") };
        serde_json::from_str(line).unwrap()
    };
    let told = line("req-map");
    assert_eq!(
        (&told["target"], &told["port"], &told["method"]),
        (&"access".into(), &"http".into(), &"GET".into())
    );
    assert_eq!((&told["call"], &told["code"]), (&"/api/v1/map".into(), &"200".into()));
    assert_eq!((&told["bytes"], &told["role"]), (&map.body.len().into(), &"viewer".into()));
    assert!(told["ms"].as_f64().unwrap() >= 0.0 && told["whole"] == true, "{told}");
    for (id, call, code, role) in [
        ("req-at", "/api/v1/tiles/at", "404", "viewer"),
        ("req-backup", "/api/v1/map/backup", "403", "viewer"),
        ("req-nowhere", "unknown", "404", "none"),
        ("req-unknown", "/api/v1/map", "401", "none"),
        ("req-localize", "/echofix.v1.LocalizationService/Localize", "UNAUTHENTICATED", "none"),
    ] {
        let told = line(id);
        let words = (told["call"].as_str(), told["code"].as_str(), told["role"].as_str());
        assert_eq!(words, (Some(call), Some(code), Some(role)), "{told}");
    }
    let log = service.log();
    for private in ["anna-1", "48.137", "11.575", &token] {
        assert!(!log.contains(private), "{private}:\n{log}");
    }
    let silent = Service::start();
    get_with(&format!("{}/api/v1/map", silent.http), &[("x-request-id", "req-silent")]);
    get(&format!("{}/readyz", silent.http));
    assert!(!silent.log().contains("req-silent") && !silent.log().contains("answered"), "{}", silent.log());
}

/// Catches: an RPC that is answered and told under another code.
#[tokio::test(flavor = "multi_thread")]
async fn an_upload_is_told_with_its_code_and_role() {
    let service = Service::start_with(&["log.access=true"]);
    let survey = town::survey(&town::town(town::seed()), 0, "mapper-9", town::seed());
    let upload = mapping::uploads(&survey).remove(0);
    mapping::send(&mut grpc::mapping(&service).await, upload.parts()).await.expect("the upload counts");
    let log = until_blocking("the call is told", PATIENCE, || {
        let log = service.log();
        log.contains("/echofix.v1.MappingService/Upload").then_some(log)
    });
    let line = log.lines().find(|line| line.contains("/echofix.v1.MappingService/Upload")).unwrap();
    for part in ["access", "port=\"grpc\"", "code=\"OK\"", "role=\"admin\"", "request_id=\""] {
        assert!(line.contains(part), "{part}: {line}");
    }
    assert!(!line.contains("mapper-9") && !line.contains("bytes=0"), "{line}");
}

/// Catches: an upload that a listener missed while it was away, and a gap of another run that is passed over in silence.
#[tokio::test(flavor = "multi_thread")]
async fn a_listener_that_comes_again_hears_what_it_missed() {
    let mut service = Service::start();
    let survey = town::survey(&town::town(town::seed()), 0, "mapper", town::seed());
    let mut uploads = mapping::uploads(&survey).into_iter();
    let mut sender = grpc::mapping(&service).await;
    let url = |service: &Service| format!("{}/api/v1/events", service.http);
    let mut events = Events::listen(&url(&service), PATIENCE);
    events.next("map");
    mapping::send(&mut sender, uploads.next().unwrap().parts()).await.expect("the upload counts");
    events.next("upload");
    let id = events.id.clone();
    drop(events);
    let away = mapping::send(&mut sender, uploads.next().unwrap().parts()).await.expect("the upload counts");
    let mut events = Events::resume(&url(&service), &id, PATIENCE);
    assert_eq!(events.next("upload")["upload_id"], away.upload_id);
    assert_ne!(events.id, id);
    service.kill();
    service.start_again();
    let mut events = Events::resume(&url(&service), &id, PATIENCE);
    assert_eq!(events.next("missed"), serde_json::json!({ "count": null, "reason": "OTHER_RUN" }));
    assert!(!events.id.is_empty() && events.id != id);
    // A service that runs is a service that answers.
    assert_eq!(post(&format!("{}/nowhere", service.http), &serde_json::json!({})).status, 404);
}
