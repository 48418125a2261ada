//! What programs may rely on: the shape of every answer in JSON, held against `contract.json` and against the description
//! that is served.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use axum::http::Method;
use axum::response::Response;
use echofix_core::datum::Offset;
use echofix_core::pose::Pose2;
use echofix_core::vetting::Reason;
use echofix_core::vetting::alarm::QuarantinedUpload;
use serde_json::{Value, json};
use tokio_stream::StreamExt;

use super::contributor::hash_word;
use super::openapi::DOCUMENT;
use super::testing::{StoredSite, TestSite, a_fix, an_upload, austin, bytes_of, json_of, uploads_of};
use crate::identity::Gate;
use crate::store::{Policy, QuarantinedRecord};

/// Under which words a schema is made of others.
const PARTS: [&str; 3] = ["allOf", "oneOf", "anyOf"];

/// Answers by the operation that gives them, `METHOD route`, and what is special about each.
type Answers = BTreeMap<(&'static str, &'static str), Value>;

/// Three contributors whose uploads lie alike beside the map, and one that shows something else.
fn kept_out() -> Vec<QuarantinedRecord> {
    let offset = Offset::of(&Pose2::new(1.5, 0.25, 0.01));
    let record = |(contributor, offset): (u64, Option<Offset>)| QuarantinedRecord {
        number: contributor,
        reason: if offset.is_some() { Reason::Shifted } else { Reason::Disagrees },
        upload: QuarantinedUpload {
            zone: austin().zone,
            position: austin().origin(),
            offset,
            contributor,
            day: 20_000,
        },
    };
    [(1, Some(offset)), (2, Some(offset)), (3, Some(offset)), (4, None)].map(record).to_vec()
}

/// Of a map in memory.
async fn of_a_small_map(answers: &mut Answers) {
    let cells: Vec<(u32, u32)> = (0..40).map(|k| (k * 6007 % (512 * 512), 1)).collect();
    let site = TestSite::with_tiles(&[(austin(), &cells)]);
    *site.store.kept_out.lock().unwrap() = kept_out();
    site.state.feed.fixes.publish(a_fix());
    site.state.feed.uploads.publish(an_upload());
    let corner = json_of(site.get(&format!("/api/v1/tiles/{}", austin())).await).await["corners"][0].clone();
    let [west, south] = [0, 1].map(|axis| corner[axis].as_f64().unwrap());
    let at = format!("/api/v1/tiles/at?lat={}&lon={}", south + 2e-4, west + 2e-4);
    let tile = format!("/api/v1/tiles/{}", austin());
    let expected = format!("{tile}/localizability");
    for (operation, path) in [
        ("GET /healthz", "/healthz"),
        ("GET /readyz", "/readyz"),
        ("GET /tiles/{layer}", "/tiles/age.json"),
        ("GET /api/v1/map", "/api/v1/map"),
        ("GET /api/v1/map/quarantine", "/api/v1/map/quarantine"),
        ("GET /api/v1/tiles/at", &at),
        ("GET /api/v1/tiles/{epsg}/{x}/{y}", &tile),
        ("GET /api/v1/tiles/{epsg}/{x}/{y}/localizability", &expected),
        ("GET /api/v1/fixes", "/api/v1/fixes"),
        ("GET /api/v1/uploads", "/api/v1/uploads"),
        ("GET /session", "/session"),
        ("GET /session/ways", "/session/ways"),
        ("GET /base-map", "/base-map"),
    ] {
        answers.insert((operation, ""), json_of(site.get(path).await).await);
    }
    answers.insert(("GET /api/v1/map", "error"), json_of(site.get("/nowhere").await).await);
    let events = site.send(Method::GET, "/api/v1/events", &[("last-event-id", "other")]).await;
    for (kind, data) in heard(events, &["map", "health", "missed"]).await {
        answers.insert(("GET /api/v1/events", kind), data);
    }
    let empty = TestSite::default();
    empty.state.health.ready();
    for (operation, path) in [
        ("GET /readyz", "/readyz"),
        ("GET /tiles/{layer}", "/tiles/age.json"),
        ("GET /api/v1/map", "/api/v1/map"),
        ("GET /api/v1/map/quarantine", "/api/v1/map/quarantine"),
    ] {
        answers.insert((operation, "empty"), json_of(empty.get(path).await).await);
    }
}

/// The data of the first event of each of these kinds.
async fn heard(events: Response, kinds: &[&'static str]) -> Vec<(&'static str, Value)> {
    let (mut body, mut text) = (events.into_body().into_data_stream(), String::new());
    let data = |text: &str, kind: &str| {
        let block = text.split_once(&format!("event: {kind}\n"))?.1.split_once("\n\n")?.0;
        let data = block.lines().find_map(|line| line.strip_prefix("data: "))?;
        serde_json::from_str(data).ok()
    };
    loop {
        let found: Vec<_> =
            kinds.iter().filter_map(|kind| data(&text, kind).map(|data| (*kind, data))).collect();
        if found.len() == kinds.len() {
            return found;
        }
        text += std::str::from_utf8(&body.next().await.unwrap().unwrap()).unwrap();
    }
}

/// Of a tile to the cell.
async fn of_cells(answers: &mut Answers) {
    let uploads = uploads_of(&[(7, &[5, 300]), (8, &[5])]);
    let site = StoredSite::of(uploads, Policy::trusting(), Gate::open()).await;
    let tile = format!("/api/v1/tiles/{}/cells", austin());
    let whole = json_of(site.get(&tile).await).await;
    let [lat, lon] = ["latitude_deg", "longitude_deg"].map(|axis| whole["cells"][0][axis].as_f64().unwrap());
    let beside = lat + 1e-4;
    for (operation, special, path) in [
        ("GET /api/v1/tiles/{epsg}/{x}/{y}/cells", "a part", format!("{tile}?limit=1")),
        ("GET /api/v1/cells/at", "", format!("/api/v1/cells/at?lat={lat}&lon={lon}")),
        ("GET /api/v1/cells/at", "none", format!("/api/v1/cells/at?lat={beside}&lon={lon}")),
    ] {
        answers.insert((operation, special), json_of(site.get(&path).await).await);
    }
    answers.insert(("GET /api/v1/tiles/{epsg}/{x}/{y}/cells", ""), whole);
}

/// Of a map on disk, and of what is decided about it.
async fn of_decisions(answers: &mut Answers) {
    let (site, other) = (StoredSite::with_uploads(6).await, StoredSite::with_uploads(2).await);
    let region = bytes_of(other.get("/api/v1/map/export").await).await;
    let imported = site.send("/api/v1/map/import", "application/octet-stream", region.to_vec()).await;
    answers.insert(("POST /api/v1/map/import", ""), json_of(imported).await);
    let upload = site.uploads[1].id.to_string();
    for (operation, special, body) in [
        ("POST /api/v1/map/rollback", "dry run", json!({ "epoch": 4, "dry_run": true })),
        ("POST /api/v1/map/rollback", "", json!({ "epoch": 4, "reason": "a shifted street" })),
        ("POST /api/v1/map/revoke", "", json!({ "upload": upload })),
        ("POST /api/v1/map/revoke", "again", json!({ "upload": upload })),
        (
            "POST /api/v1/map/revoke",
            "contributor",
            json!({ "contributor_hash": hash_word(site.uploads[2].pass.contributor) }),
        ),
    ] {
        let answer = site.post(operation.trim_start_matches("POST "), &body).await;
        answers.insert((operation, special), json_of(answer).await);
        site.caught_up().await;
    }
    let decision = &answers[&("POST /api/v1/map/rollback", "")]["epoch"];
    let undone = site.post("/api/v1/map/undo", &json!({ "decision": decision })).await;
    answers.insert(("POST /api/v1/map/undo", ""), json_of(undone).await);
    site.caught_up().await;
    let hash = hash_word(site.uploads[2].pass.contributor);
    let uploads = format!("/api/v1/contributors/{hash}/uploads?limit=1");
    let alone = format!("/api/v1/uploads/{upload}");
    for (operation, path) in [
        ("GET /api/v1/map/history", "/api/v1/map/history"),
        ("GET /api/v1/contributors", "/api/v1/contributors?only=revoked"),
        ("GET /api/v1/contributors/{hash}/uploads", &uploads),
        ("GET /api/v1/uploads/{id}", &alone),
        ("GET /api/v1/map/diff", "/api/v1/map/diff?from=6&to=8"),
        ("GET /api/v1/map/verify", "/api/v1/map/verify"),
    ] {
        answers.insert((operation, ""), json_of(site.get(path).await).await);
    }
    let replayed = site.post("/api/v1/map/verify?replay=true", &json!({})).await;
    answers.insert(("POST /api/v1/map/verify", ""), json_of(replayed).await);
    for route in ["compact", "settle"] {
        let operation =
            if route == "compact" { "POST /api/v1/map/compact" } else { "POST /api/v1/map/settle" };
        let body = json!({ "before": "2026-01-01", "dry_run": route == "settle" });
        let answer = site.post(&format!("/api/v1/map/{route}"), &body).await;
        answers.insert((operation, ""), json_of(answer).await);
    }
    answers.insert(
        ("GET /api/v1/map/history", "compacted"),
        json_of(site.get("/api/v1/map/history").await).await,
    );
}

async fn answers() -> Answers {
    let mut answers = Answers::new();
    of_a_small_map(&mut answers).await;
    of_cells(&mut answers).await;
    of_decisions(&mut answers).await;
    answers
}

/// The kind of each value; of a list, the shapes that its items have.
fn shape(value: &Value) -> Value {
    match value {
        Value::Null => "null".into(),
        Value::Bool(_) => "boolean".into(),
        Value::Number(number) => if number.is_f64() { "number" } else { "integer" }.into(),
        Value::String(_) => "string".into(),
        Value::Array(items) => {
            let shapes: BTreeMap<_, _> =
                items.iter().map(shape).map(|shape| (shape.to_string(), shape)).collect();
            shapes.into_values().collect()
        }
        Value::Object(fields) => fields.iter().map(|(name, field)| (name.clone(), shape(field))).collect(),
    }
}

/// Catches: a field that is renamed, lost or another kind of value: the console, the command and other people's programs read
/// these answers. What is meant is written down by `ECHOFIX_BLESS=1 cargo test -p echofix-server contract`.
#[tokio::test]
async fn answers_have_the_shape_that_programs_know() {
    let shapes: Value = answers()
        .await
        .iter()
        .map(|((operation, special), answer)| (format!("{operation} {special}"), shape(answer)))
        .collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/http/contract.json");
    let written = format!("{shapes:#}\n");
    if std::env::var_os("ECHOFIX_BLESS").is_some() {
        std::fs::write(&path, &written).unwrap();
    }
    assert_eq!(written, std::fs::read_to_string(path).unwrap(), "is the change of the answers meant?");
}

/// Forbids in a schema whatever it does not name; of one that is a part of another, in what lies within it only.
fn close(schema: &mut Value, is_whole: bool) {
    let Value::Object(fields) = schema else {
        return schema.as_array_mut().into_iter().flatten().for_each(|item| close(item, true));
    };
    let mut names_properties = fields.contains_key("properties");
    for (name, inner) in fields.iter_mut() {
        if PARTS.contains(&name.as_str()) {
            names_properties = true;
            inner.as_array_mut().into_iter().flatten().for_each(|part| close(part, false));
        } else {
            close(inner, true);
        }
    }
    if is_whole && names_properties {
        fields.insert("unevaluatedProperties".to_owned(), false.into());
    }
}

/// The names of all schemas that are parts of others.
fn parts(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Array(items) => items.iter().for_each(|item| parts(item, found)),
        Value::Object(fields) => {
            for of in PARTS {
                let named = fields.get(of).and_then(Value::as_array).into_iter().flatten();
                let named = named.filter_map(|part| part["$ref"].as_str()?.rsplit_once('/'));
                found.extend(named.map(|(_, name)| name.to_owned()));
            }
            fields.values().for_each(|field| parts(field, found));
        }
        _ => {}
    }
}

/// The document as a schema that knows no other properties than those that are described.
fn closed() -> Value {
    let mut document: Value = serde_json::from_str(&DOCUMENT).unwrap();
    let mut joined = BTreeSet::new();
    parts(&document, &mut joined);
    for (name, schema) in document["components"]["schemas"].as_object_mut().unwrap() {
        close(schema, !joined.contains(name));
    }
    document
}

fn validated(document: &Value, pointer: &str, answer: &Value) -> Vec<String> {
    let mut schema = document.clone();
    schema["$ref"] = format!("#{pointer}").into();
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    let validator = jsonschema::validator_for(&schema).unwrap();
    validator.iter_errors(answer).map(|error| format!("{}: {error}", error.instance_path())).collect()
}

/// Catches: a description that says something else than what is answered: a field that it lacks or that the answer lacks, another
/// kind of value, or a null that it does not allow.
#[tokio::test]
async fn answers_are_as_described() {
    let document = closed();
    let answers = answers().await;
    for ((operation, special), answer) in &answers {
        let (method, route) = operation.split_once(' ').unwrap();
        let path = if *route == *"/tiles/{layer}" { "/tiles/{layer}.json" } else { route };
        let path = path.replace('~', "~0").replace('/', "~1").replace('{', "%7B").replace('}', "%7D");
        let status = if *special == "error" { "default" } else { "200" };
        let media = "content/application~1json/schema";
        let pointer = match *special {
            "map" => "/components/schemas/Progress".to_owned(),
            "health" => "/components/schemas/Readiness".to_owned(),
            "missed" => "/components/schemas/Missed".to_owned(),
            _ => format!("/paths/{path}/{}/responses/{status}/{media}", method.to_lowercase()),
        };
        assert_eq!(
            validated(&document, &pointer, answer),
            Vec::<String>::new(),
            "{operation} {special}: {answer}"
        );
    }
    // The check itself: what is not described is found.
    let mut other = answers[&("GET /api/v1/map", "")].clone();
    other["totals"]["colour"] = "red".into();
    assert!(!validated(&document, "/components/schemas/Map", &other).is_empty());
    other["totals"] = json!({});
    assert!(!validated(&document, "/components/schemas/Map", &other).is_empty());
}
