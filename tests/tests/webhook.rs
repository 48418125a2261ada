//! Alarms are sent to a webhook: to a small HTTP receiver that fails first, with a secret, a link and all that the message promises.

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::Duration;

use echofix_tests::crowd::{quarantine, shifted, street};
use echofix_tests::mapping::contribute;
use echofix_tests::service::Service;
use echofix_tests::{http, town, until_blocking};
use serde_json::{Value, json};

/// From an alarm to its message, two pauses of seconds and a loaded machine included.
const PATIENCE: Duration = Duration::from_mins(1);
/// No message: long enough for one that should not come to be noticed, where it would come at once.
const SILENCE: Duration = Duration::from_secs(4);

/// What was posted.
#[derive(Debug, Clone, PartialEq)]
struct Posted {
    path: String,
    authorization: Option<String>,
    content_type: Option<String>,
    body: Value,
}

/// Receives at a free port: breaks the first connection off, answers the second request 503, takes all others.
fn receiver() -> (String, Receiver<Posted>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let address = listener.local_addr().expect("it has an address");
    let (tell, posted) = mpsc::channel();
    thread::spawn(move || {
        for (number, stream) in listener.incoming().enumerate() {
            let Ok(stream) = stream else { return };
            let answer = match number {
                0 => "",
                1 => "HTTP/1.1 503 Service Unavailable\r\ncontent-length: 0\r\nconnection: close\r\n\r\n",
                _ => "HTTP/1.1 204 No Content\r\nconnection: close\r\n\r\n",
            };
            if receive(stream, answer, &tell).is_none() {
                return;
            }
        }
    });
    (format!("http://{address}/hooks/T0KEN"), posted)
}

/// Reads one request, tells it, and answers; `None` once nobody listens.
fn receive(mut stream: TcpStream, answer: &str, tell: &Sender<Posted>) -> Option<()> {
    let mut lines = BufReader::new(stream.try_clone().ok()?);
    let (mut head, mut line) = (Vec::new(), String::new());
    while lines.read_line(&mut line).ok()? > 2 {
        head.push(std::mem::take(&mut line).trim_end().to_owned());
    }
    let header = |name: &str| {
        let of = |line: &String| {
            let (key, value) = line.split_once(": ")?;
            key.eq_ignore_ascii_case(name).then(|| value.to_owned())
        };
        head.iter().find_map(of)
    };
    let mut body = vec![0; header("content-length")?.parse().ok()?];
    lines.read_exact(&mut body).ok()?;
    let posted = Posted {
        path: head.first()?.clone(),
        authorization: header("authorization"),
        content_type: header("content-type"),
        body: serde_json::from_slice(&body).ok()?,
    };
    // A receiver that went away is the service's to bear.
    let _ = stream.write_all(answer.as_bytes());
    tell.send(posted).ok()
}

fn next(posted: &Receiver<Posted>) -> Posted {
    posted.recv_timeout(PATIENCE).expect("a message comes")
}

/// Catches: an alarm that nobody is told of, that is lost with a receiver which fails, comes without its secret, names somebody, leads
/// nowhere, is sent once more with every upload that joins it, or is forgotten over a restart; and a secret that is logged.
#[tokio::test(flavor = "multi_thread")]
async fn an_alarm_is_sent_until_it_is_taken_and_once() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let secret = folder.path().join("secret");
    fs::write(&secret, "s3cret-of-the-pager\n").expect("it can be written");
    let (url, posted) = receiver();
    let mut service = Service::start_with(&[
        &format!("alarms.webhook={url}"),
        &format!("alarms.webhook_secret={}", secret.display()),
        "alarms.console=https://maps.example/echofix/",
    ]);
    let city = town::town(town::seed());
    let off = |day, vehicle| shifted(street(&city, day, vehicle), 0.0, 1.5);
    for (day, vehicle) in (0..).zip(["anna", "boris"]) {
        contribute(&service, &street(&city, day, vehicle)).await;
    }
    for (day, vehicle) in (5..).zip(["dora", "emil", "fritz"]) {
        contribute(&service, &off(day, vehicle)).await;
    }

    let first = next(&posted);
    assert!(first.path.starts_with("POST /hooks/T0KEN HTTP/1.1"), "{first:?}");
    assert_eq!(first.authorization.as_deref(), Some("Bearer s3cret-of-the-pager"));
    assert_eq!(first.content_type.as_deref(), Some("application/json"));
    tells_of_the_alarm(&service, &first.body);
    assert_eq!(
        [next(&posted), next(&posted)],
        [first.clone(), first.clone()],
        "tried again until it is taken"
    );
    let of = |outcome: &str| {
        let metrics = http::get(&format!("{}/metrics", service.http));
        http::metric(metrics.text(), &format!("echofix_alarm_messages_total{{outcome=\"{outcome}\"}}")) as u64
    };
    until_blocking("it is counted", PATIENCE, || (of("delivered") >= 1).then_some(()));
    assert_eq!((of("failed"), of("dropped")), (0, 0));

    // Another one who agrees: the same alarm.
    contribute(&service, &off(8, "gerda")).await;
    until_blocking("the alarm has four", PATIENCE, || {
        let alarms = quarantine(&service)["alarms"].as_array()?.clone();
        alarms.iter().any(|alarm| alarm["contributors"] == 4).then_some(())
    });
    let near = |more: &Posted| {
        let of = |posted: &Posted, axis: &str| posted.body["place"][axis].as_f64().expect("a place");
        ["lat", "lon"].iter().all(|axis| (of(more, axis) - of(&first, axis)).abs() < 2e-4)
    };
    let again = posted.recv_timeout(SILENCE).ok().filter(near);
    assert_eq!(again, None, "an alarm that lasts is not sent again");

    // A service that begins anew knows nobody who was told.
    service.kill();
    service.start_again();
    let later = next(&posted);
    assert!(later.body["kind"] == "SHIFT" && later.body["count"].as_u64() >= Some(3), "{later:?}");
    let log = service.log();
    assert!(log.contains("an alarm could not be sent; trying again"), "{log}");
    assert!(!log.contains("s3cret") && !log.contains("T0KEN"), "a secret is logged:\n{log}");
}

/// The message says what the quarantine says.
fn tells_of_the_alarm(service: &Service, message: &Value) {
    let report = quarantine(service);
    assert_eq!(
        (&message["service"], &message["kind"], &message["count"]),
        (&json!("echofix"), &json!("SHIFT"), &json!(3))
    );
    let off = |axis: &str| message["offset"][axis].as_f64().expect("a shift has an offset");
    assert!(off("east_m").hypot(off("north_m") + 1.5) < 0.6, "{message:#}");
    let alarms = report["alarms"].as_array().expect("alarms are a list");
    assert!(alarms.iter().any(|alarm| alarm["since"] == message["since"]), "{message:#} {report:#}");
    let named: BTreeSet<&str> =
        message["contributors"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    let kept_out = report["uploads"].as_array().expect("a list");
    let hashes: BTreeSet<&str> =
        kept_out.iter().filter_map(|upload| upload["contributor"].as_str()).collect();
    assert!(named.len() == 3 && named == hashes, "{named:?} {hashes:?}");
    let link = message["link"].as_str().expect("a link");
    let view = link.strip_prefix("https://maps.example/echofix/#view=18/").expect("it leads to the place");
    let (lat, lon) = view.split_once('/').expect("a place");
    let place = [lat, lon].map(|degrees| degrees.parse::<f64>().expect("degrees"));
    let of = |axis: &str| message["place"][axis].as_f64().expect("a place");
    assert!((place[0] - of("lat")).abs() < 1e-6 && (place[1] - of("lon")).abs() < 1e-6, "{link} {message}");
    let text = message.to_string();
    assert!(["dora", "emil", "fritz"].iter().all(|name| !text.contains(name)), "{text}");
}
