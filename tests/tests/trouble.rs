//! The disk fails in one of its ways while the service runs, or somebody removed a part of its data: what was acknowledged
//! is there, nothing of others is touched, localizing goes on, and the service says what is the matter.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use echofix_proto::v1::LocalizeRequest;
use echofix_proto::v1::localization_service_client::LocalizationServiceClient;
use echofix_tests::disk::Disk;
use echofix_tests::limits::{self, Unsignalled};
use echofix_tests::service::{Service, Setup};
use echofix_tests::traffic::Uploads;
use echofix_tests::world::World;
use echofix_tests::{command, grpc, http, mapping, tiles, town, until};
use serde_json::Value;
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;

/// From the end of the trouble to the service as it was.
const RECOVERS_WITHIN: Duration = Duration::from_secs(10);

/// A town that is mapped, the questions of a drive through it, and a connection that is open.
struct Scene {
    world: World,
    questions: Vec<LocalizeRequest>,
    uploads: Uploads,
    channel: Channel,
    _unsignalled: Unsignalled,
}

impl Scene {
    async fn new() -> Self {
        Self::in_folder(None).await
    }

    /// The data directory, if it is not to be one of the service's own folder.
    async fn in_folder(data_dir: Option<PathBuf>) -> Self {
        let unsignalled = Unsignalled::new();
        let setup = Setup { program: Some(unsignalled.program()), data_dir, ..Setup::default() };
        let world = World::mapped_with(Service::start_as(setup)).await;
        let questions = world.questions(300.0, 5.0).into_iter().map(|question| question.request).collect();
        let channel = grpc::connect(&world.service).await;
        Self { uploads: Uploads::new(world.seed), world, questions, channel, _unsignalled: unsignalled }
    }

    /// How many of the questions are answered at all.
    async fn answered(&self) -> usize {
        let mut client = LocalizationServiceClient::new(self.channel.clone());
        let mut answered = 0;
        for question in &self.questions {
            match client.localize(question.clone()).await {
                Ok(_) => answered += 1,
                Err(status) => assert_eq!(status.code(), Code::FailedPrecondition, "{status:?}"),
            }
        }
        answered
    }

    fn ready(&self) -> Value {
        let answer = http::get(&format!("{}/readyz", self.world.service.http));
        assert_eq!(answer.status, 200, "{}", answer.text());
        answer.json()
    }

    /// Sends an upload; the service's refusal.
    async fn send(&self, number: u32) -> Result<(), tonic::Status> {
        let mut client = grpc::mapping_on(self.channel.clone());
        mapping::send(&mut client, &self.uploads.parts(number)).await.map(drop)
    }

    /// Uploads until one is refused, which must be for the moment.
    async fn send_until_refused(&self) -> Vec<u32> {
        let mut acknowledged = Vec::new();
        loop {
            let number = self.uploads.fresh();
            match self.send(number).await {
                Ok(()) => acknowledged.push(number),
                Err(status) => {
                    assert_eq!(status.code(), Code::Unavailable, "{status:?}");
                    assert!(status.get_details_retry_info().is_some(), "{status:?}");
                    return acknowledged;
                }
            }
            assert!(acknowledged.len() < 500, "nothing is refused");
        }
    }

    /// Waits until readiness follows what the disk did.
    async fn says_that_it_takes_none(&self) {
        until("no uploads are welcome", Duration::from_secs(5), async || {
            let both = self.ready()["uploading"]["ready"] == false
                && self.health("echofix.v1.MappingService").await == ServingStatus::NotServing;
            both.then_some(())
        })
        .await;
    }

    async fn health(&self, name: &str) -> ServingStatus {
        let mut health = HealthClient::new(self.channel.clone());
        let answer = health.check(HealthCheckRequest { service: name.to_owned() }).await;
        answer.expect("the service has a health").into_inner().status()
    }

    /// Waits until uploads are welcome again; how long it took.
    async fn recovers(&self) -> Duration {
        let began = Instant::now();
        until("uploads are welcome again", RECOVERS_WITHIN, async || {
            let ready = self.ready();
            (ready["uploading"]["ready"] == true && ready["reason"].is_null()).then_some(())
        })
        .await;
        began.elapsed()
    }
}

/// Catches: uploads acknowledged on a full disk, a map that cannot be localized against then, a service that needs a restart
/// once there is room, and one that does not end when it is told to.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_takes_no_uploads_and_localizing_goes_on() {
    let mut scene = Scene::new().await;
    let before = scene.answered().await;
    assert!(before > 5, "{before} of {}", scene.questions.len());
    for limit in [0, tiles_bytes(&scene.world.service), 0] {
        limits::file_bytes(&scene.world.service, Some(limit));
        let taken = if limit == 0 { scene.send_until_refused().await.len() } else { 0 };
        assert!(taken == 0, "{taken} were acknowledged, nowhere");
        if limit == 0 {
            scene.says_that_it_takes_none().await;
            assert_eq!(scene.health("echofix.v1.MappingService").await, ServingStatus::NotServing);
            assert_eq!(scene.health("echofix.v1.LocalizationService").await, ServingStatus::Serving);
        } else {
            // The journal, whose file is a new one, takes them; the tiles' file may not grow.
            until("folding stalls", Duration::from_mins(1), async || {
                scene.send(scene.uploads.fresh()).await.expect("the journal has room");
                let ready = scene.ready();
                ready["reason"].as_str().is_some_and(|reason| reason.contains("folding")).then_some(())
            })
            .await;
        }
        assert_eq!(scene.answered().await, before, "localizing goes on");
        assert_eq!(http::get(&format!("{}/healthz", scene.world.service.http)).status, 200);
        limits::file_bytes(&scene.world.service, None);
        let took = scene.recovers().await;
        eprintln!("limit {limit}: as before {took:?} after there was room");
        scene.send(scene.uploads.fresh()).await.expect("uploads are taken again");
        mapping::folded(&scene.world.service).await;
    }
    let map = tiles::all(&scene.world.service).await;
    let service = &mut scene.world.service;
    limits::file_bytes(service, Some(0));
    service.ask_to_end();
    assert!(service.ended().success(), "{}", service.log());
    service.start_again();
    mapping::folded(service).await;
    assert_eq!(tiles::all(service).await, map, "nothing acknowledged is lost");
}

/// Catches: what a limit of files does not show: a file system that refuses names, too, and a start on it.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs root and loop devices"]
async fn a_file_system_that_is_full_takes_no_uploads_and_the_map_is_served_from_it() {
    let disk = Disk::of(96 << 20);
    let mut scene = Scene::in_folder(Some(disk.path().join("data"))).await;
    let before = scene.answered().await;
    disk.fill();
    scene.send_until_refused().await;
    scene.says_that_it_takes_none().await;
    assert_eq!(scene.answered().await, before);
    scene.world.service.kill();
    scene.world.service.start_again();
    scene.channel = grpc::connect(&scene.world.service).await;
    assert_eq!(scene.answered().await, before, "after a start on the full disk");
    disk.free();
    eprintln!("as before {:?} after there was room", scene.recovers().await);
    scene.send(scene.uploads.fresh()).await.expect("uploads are taken again");
    mapping::folded(&scene.world.service).await;
    assert_eq!(scene.answered().await, before);
}

/// Catches: a service that stops for good because it could not open one more file.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_without_a_free_descriptor_goes_on() {
    let scene = Scene::new().await;
    let before = scene.answered().await;
    limits::no_more_files(&scene.world.service, true);
    assert_eq!(scene.answered().await, before);
    // The segment that is open takes what comes; folding cannot read it.
    let _ = scene.send(scene.uploads.fresh()).await;
    assert_eq!(scene.answered().await, before);
    limits::no_more_files(&scene.world.service, false);
    scene.recovers().await;
    scene.send(scene.uploads.fresh()).await.expect("uploads are taken again");
    mapping::folded(&scene.world.service).await;
    assert_eq!(scene.answered().await, before);
}

/// Catches: a map that cannot be localized against, because somebody removed its files from under the service.
#[tokio::test(flavor = "multi_thread")]
async fn tiles_removed_while_it_runs_are_served_and_made_again() {
    let mut scene = Scene::new().await;
    let before = scene.answered().await;
    let map = tiles::all(&scene.world.service).await;
    fs::remove_dir_all(tiles_of(&scene.world.service)).unwrap();
    assert_eq!(scene.answered().await, before);
    scene.send(scene.uploads.fresh()).await.expect("the journal is there");
    scene.world.service.kill();
    scene.world.service.start_again();
    mapping::folded(&scene.world.service).await;
    let after = tiles::all(&scene.world.service).await;
    assert!(map.keys().all(|tile| after.contains_key(tile)));
}

/// Catches: a part of the data that is not there, or is damaged, and takes the others with it.
#[tokio::test(flavor = "multi_thread")]
async fn a_missing_or_damaged_part_never_destroys_the_others() {
    let mut service = Service::start();
    let uploads = Uploads::new(town::seed());
    let mut client = grpc::mapping(&service).await;
    for number in 0..20 {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("it is acknowledged");
    }
    mapping::folded(&service).await;
    let map = tiles::all(&service).await;
    service.ask_to_end();
    assert!(service.ended().success());
    let (sound, data) = (service.scratch().join("sound"), service.data_dir());
    copy(&data, &sound);
    let rebuilt = ["key", "key-copy", "manifest", "tiles-1", "lock", "writer"];
    for part in rebuilt.into_iter().chain(["journal"]) {
        for damage in [false, true] {
            for name in ["notes.new", "tiles-old/thesis.tex", "scratch/thesis.tex", "base-3", "tiles-77"] {
                let path = data.join(name);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, "years of work").unwrap();
            }
            spoil(&data.join(part), damage);
            let before = snapshot(&data);
            let run = command::echofix(["serve", "--data-dir", data.to_str().unwrap(), "--check-config"]);
            assert_eq!(run.code, Some(0), "{run:?}");
            service.launch_again();
            let ready = service.becomes_ready();
            assert_eq!(ready, part != "journal", "{part}, damaged {damage}:\n{}", service.log());
            if ready {
                mapping::folded(&service).await;
                let alike = (tiles::but_lineage(tiles::all(&service).await), tiles::but_lineage(map.clone()));
                assert_eq!(alike.0, alike.1, "{part}, damaged {damage}");
                service.kill();
            } else {
                assert_eq!(snapshot(&data), before, "{part}, damaged {damage}: nothing was changed");
                assert!(service.log().contains("journal"));
            }
            let after = snapshot(&data);
            let theirs = before.iter().filter(|(_, content)| *content == b"years of work");
            assert!(
                theirs.clone().count() == 5 && theirs.into_iter().all(|(path, _)| after.contains_key(path))
            );
            fs::remove_dir_all(&data).unwrap();
            copy(&sound, &data);
        }
    }
}

/// Catches: two services on one directory, since somebody removed the lock file.
#[tokio::test(flavor = "multi_thread")]
async fn a_removed_lock_file_lets_no_second_service_in() {
    let service = Service::start();
    for name in ["lock", "lock"] {
        let _ = fs::remove_file(service.data_dir().join(name));
        let data = service.data_dir();
        let run = command::echofix([
            "serve",
            "--set",
            "grpc.listen=127.0.0.1:0",
            "--set",
            "http.listen=127.0.0.1:0",
            "--data-dir",
            data.to_str().unwrap(),
        ]);
        assert_eq!(run.code, Some(1), "{run:?}");
        assert!(run.stderr.contains("in use"), "{run:?}");
    }
    let mut client = grpc::mapping(&service).await;
    let uploads = Uploads::new(town::seed());
    mapping::send(&mut client, &uploads.parts(1)).await.expect("the first one goes on");
}

/// Bytes that sled's file takes.
fn tiles_bytes(service: &Service) -> u64 {
    fs::metadata(tiles_of(service).join("db")).expect("sled has a file").len()
}

/// The directory of the tiles that are served.
fn tiles_of(service: &Service) -> PathBuf {
    let names = fs::read_dir(service.data_dir())
        .expect("an own folder can be used")
        .map(|entry| entry.expect("an own folder can be used").path());
    let mut tiles =
        names.filter(|path| path.file_name().expect("it has a name").to_string_lossy().starts_with("tiles-"));
    let path = tiles.next().expect("there are tiles");
    assert_eq!(tiles.next(), None);
    path
}

fn spoil(path: &Path, damage: bool) {
    match (path.is_dir(), damage) {
        (true, false) => fs::remove_dir_all(path).expect("an own folder can be used"),
        (false, false) => fs::remove_file(path).expect("an own folder can be used"),
        (false, true) => fs::write(path, "not what it was").expect("an own folder can be used"),
        (true, true) => {
            for entry in fs::read_dir(path)
                .expect("an own folder can be used")
                .map(|entry| entry.expect("an own folder can be used").path())
            {
                if entry.is_file() {
                    let mut bytes = fs::read(&entry).expect("an own folder can be used");
                    let middle = bytes.len() / 2;
                    bytes[middle..].iter_mut().take(64).for_each(|byte| *byte ^= 0x5a);
                    fs::write(&entry, bytes).expect("an own folder can be used");
                }
            }
        }
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("an own folder can be used");
    for entry in fs::read_dir(from)
        .expect("an own folder can be used")
        .map(|entry| entry.expect("an own folder can be read"))
    {
        let to = to.join(entry.file_name());
        if entry.file_type().expect("an own folder can be used").is_dir() {
            copy(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).expect("an own folder can be used");
        }
    }
}

/// What is in a directory, but for what tells that a service had it open.
fn snapshot(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(folder)
            .expect("an own folder can be used")
            .map(|entry| entry.expect("an own folder can be used").path())
        {
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with("writer") && !path.ends_with("lock") {
                found.insert(path.clone(), fs::read(path).expect("an own folder can be used"));
            }
        }
    }
    found
}
