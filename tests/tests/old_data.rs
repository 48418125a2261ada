//! Data of earlier versions: a service and a vehicle go on with what they have.
//!
//! `fixtures/v0.1` was written by version 0.1.0: three vehicles' uploads, folded under the default policy, and the tile
//! cache that `echofix tiles sync` made of them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use echofix_client::service;
use echofix_client::tiles::{Synced, TileCache, TileCacheLimits, Want};
use echofix_core::tile;
use echofix_tests::command::echofix;
use echofix_tests::crowd::{bytes, street};
use echofix_tests::mapping::contribute;
use echofix_tests::service::{Service, Setup};
use echofix_tests::tiles::{self, EVERYWHERE};
use echofix_tests::town;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/v0.1").join(name)
}

fn copied(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder can be made");
    for entry in fs::read_dir(from).expect("the fixture is there") {
        let entry = entry.expect("the fixture can be listed");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copied(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("a file can be copied");
        }
    }
}

/// The defaults, but for the retention: the fixture's uploads never become too old for this test.
fn as_of_old(data_dir: PathBuf) -> Setup {
    let settings = ["mapping.publish_contributors=3", "mapping.retention_days=36500"];
    let settings = settings.map(str::to_owned).to_vec();
    Setup { settings, data_dir: Some(data_dir), ..Setup::default() }
}

/// Catches a change of the policy's digest, of the manifest or of a stored form that makes an upgrade fold the map anew
/// under a new lineage, after which every vehicle would download its whole cache again. Twice, since the first start may
/// rewrite what it finds.
#[tokio::test(flavor = "multi_thread")]
async fn the_data_of_version_0_1_keeps_its_lineage_its_versions_and_its_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (data, cached) = (folder.path().join("data"), folder.path().join("tiles"));
    copied(&fixture("data"), &data);
    copied(&fixture("tiles"), &cached);
    let mut service = Service::start_as(as_of_old(data.clone()));
    for start in 1..=2 {
        let map = tiles::all(&service).await;
        assert!(data.join("tiles-1").exists(), "start {start} folded the map anew");
        let cache = TileCache::open(&cached, TileCacheLimits::default()).expect("an old cache can be opened");
        let versions: Vec<_> = map.iter().map(|(id, (version, _))| (*id, *version)).collect();
        assert_eq!(cache.versions(), versions, "start {start}: another lineage");
        for (id, (version, encoded)) in &map {
            let served = tile::decode(encoded).expect("a served tile is sound");
            assert_eq!(cache.tile(*id).expect("the cache is sound"), Some((*version, served)), "tile {id}");
        }
        let endpoint = service::ServiceAddress::at(&service.grpc).endpoint().expect("the address is one");
        let synced = cache.sync(&endpoint, &Want::Area(EVERYWHERE)).await.expect("the map can be read");
        let Synced { fetched, unchanged, .. } = synced;
        assert_eq!((fetched, unchanged as usize), (0, map.len()), "start {start}: {synced:?}");
        service.kill();
        service.start_again();
    }
}

/// Catches: a backup that holds less than the upgraded map, or a restored one that serves other tiles, tells another history, does not
/// replay to itself, or takes no more uploads.
#[tokio::test(flavor = "multi_thread")]
async fn an_upgrade_is_drilled_on_a_backup() {
    let folder = tempfile::tempdir().unwrap();
    let (data, drill, archive) =
        (folder.path().join("data"), folder.path().join("drill"), folder.path().join("map.tar"));
    copied(&fixture("data"), &data);
    let upgraded = Service::start_as(as_of_old(data));
    let operate = |service: &Service, words: &[&str]| {
        echofix(["map"].iter().chain(words).chain(&["--http", &service.http, "--json"])).json()
    };
    operate(&upgraded, &["backup", archive.to_str().unwrap()]);
    fs::create_dir(&drill).unwrap();
    let unpacked = Command::new("tar").arg("xf").arg(&archive).arg("-C").arg(&drill).status();
    assert!(unpacked.unwrap().success());

    let restored = Service::start_as(as_of_old(drill));
    let (served, drilled) = (tiles::all(&upgraded).await, tiles::all(&restored).await);
    assert!(!served.is_empty() && bytes(&served) == bytes(&drilled), "the same map");
    assert_eq!(operate(&restored, &["history"])["events"], operate(&upgraded, &["history"])["events"]);
    let found = operate(&restored, &["verify", "--replay"]);
    assert!(found["sound"] == true && found["compared"].as_u64() > Some(0), "{found}");
    let city = town::town(town::seed());
    contribute(&restored, &street(&city, 0, "anna")).await;
    assert!(tiles::all(&upgraded).await == served, "a drill changes nothing of what it drills");
}
