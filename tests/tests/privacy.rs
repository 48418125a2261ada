//! Who drove, when, and under which ids it was uploaded: nothing outside the journal says so.

use std::fs;
use std::path::{Path, PathBuf};

use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{UploadHeader, UploadRequest};
use echofix_tests::mapping::{folded, send, uploads};
use echofix_tests::service::Service;
use echofix_tests::{grpc, http, tiles, town};
use uuid::Uuid;

const CONTRIBUTOR: &str = "Pseudonym-of-Anna";

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("the folder can be read") {
        let path = entry.expect("the folder can be read").path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found
}

/// What must not be found: words, and how a machine would write them.
struct Secrets(Vec<(String, Vec<u8>)>);

impl Secrets {
    fn of(headers: &[UploadHeader]) -> Self {
        let mut secrets = vec![("the contributor".to_owned(), CONTRIBUTOR.as_bytes().to_vec())];
        for UploadHeader { upload_id, reference_time_us: time_us, .. } in headers {
            let id = Uuid::parse_str(upload_id).expect("an id is a UUID");
            secrets.push((format!("id {id}"), upload_id.as_bytes().to_vec()));
            secrets.push((format!("id {id}"), id.simple().to_string().into_bytes()));
            secrets.push((format!("id {id}"), id.as_bytes().to_vec()));
            secrets.push((format!("id {id}"), id.as_u128().to_le_bytes().to_vec()));
            let (seconds, tenths) = (time_us / 1_000_000, time_us / 100_000);
            secrets.push((format!("time {time_us}"), seconds.to_string().into_bytes()));
            secrets.push((format!("time {tenths}"), time_us.to_le_bytes()[..7].to_vec()));
            secrets.push((format!("time {tenths}"), time_us.to_be_bytes()[1..].to_vec()));
        }
        Self(secrets)
    }

    fn found_in(&self, bytes: &[u8]) -> Vec<&str> {
        let holds = |secret: &[u8]| bytes.windows(secret.len()).any(|window| window == secret);
        self.0.iter().filter(|(_, secret)| holds(secret)).map(|(name, _)| &name[..]).collect()
    }
}

fn header(parts: &[UploadRequest]) -> UploadHeader {
    let Some(Part::Header(header)) = &parts[0].part else { panic!("the first part is a header") };
    header.clone()
}

/// Catches: an id in the log or among the tiles, a pseudonym that is stored, times that are stored to the second.
#[tokio::test(flavor = "multi_thread")]
async fn nothing_but_the_journal_knows_who_drove_when() {
    let service = Service::start_with(&["log.filter=debug"]);
    let drive = town::wander(&town::town(town::seed()), 0, CONTRIBUTOR, 3, 250.0);
    let mut client = grpc::mapping(&service).await;
    let mut headers = Vec::new();
    for upload in uploads(&drive) {
        headers.push(header(upload.parts()));
        for _ in 0..2 {
            send(&mut client, upload.parts()).await.expect("it counts");
        }
    }
    // One that is refused.
    let mut refused = uploads(&drive)[0].parts().to_vec();
    for part in &mut refused {
        match &mut part.part {
            // What was counted is not looked at again.
            Some(Part::Header(header)) => header.upload_id = Uuid::now_v7().to_string(),
            Some(Part::Evidence(evidence)) => evidence.sigma_position_m = 5.0,
            _ => {}
        }
    }
    headers.push(header(&refused));
    send(&mut client, &refused).await.expect_err("it is refused");
    folded(&service).await;
    let revoked = serde_json::json!({ "contributor": CONTRIBUTOR });
    let secrets = Secrets::of(&headers);

    let served = tiles::all(&service).await;
    assert!(!served.is_empty());
    for (id, (_, encoded)) in &served {
        assert_eq!(secrets.found_in(encoded), [""; 0], "tile {id}");
    }
    let metrics = http::get(&format!("{}/metrics", service.http));
    assert_eq!(secrets.found_in(&metrics.body), [""; 0], "the metrics");
    // Deciding about somebody must not leave the name behind either.
    assert_eq!(http::post(&format!("{}/api/v1/map/revoke", service.http), &revoked).status, 200);
    folded(&service).await;
    let (journal, mut in_journal) = (service.data_dir().join("journal"), 0);
    for path in files(&service.data_dir()) {
        // sled writes its files anew meanwhile; those of the journal stay.
        let Ok(bytes) = fs::read(&path) else {
            assert!(!path.starts_with(&journal), "{}", path.display());
            continue;
        };
        let found = secrets.found_in(&bytes);
        if path.starts_with(&journal) {
            in_journal += found.len();
            assert!(!found.contains(&"the contributor"), "the journal keeps a keyed hash");
        } else {
            assert_eq!(found, [""; 0], "{}", path.display());
        }
    }
    // Shows that they would be found.
    assert!(in_journal >= headers.len() - 1, "the journal keeps the ids: {in_journal}");
    assert!(secrets.found_in(CONTRIBUTOR.as_bytes()) == ["the contributor"]);
    assert_eq!(secrets.found_in(service.log().as_bytes()), [""; 0], "{}", service.log());
}
