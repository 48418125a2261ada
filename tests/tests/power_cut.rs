//! Power cuts at any time: what was acknowledged is there, once, and the store opens.
//!
//! Journal and tiles lie on an ext4 image; at the instant of kill -9 the image is copied, without what the file
//! system has not written, and the service goes on with the copy. `ECHOFIX_POWER_CUTS=300` makes the long run.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use echofix_tests::disk::Disk;
use echofix_tests::service::{Service, Setup};
use echofix_tests::traffic::{Acknowledgements, Uploads};
use echofix_tests::{mapping, tiles, town};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The store that trusts `flush()`.
const STORE: &str = env!("CARGO_BIN_EXE_sled_flush");

/// What a cut takes back is folded again at every start: without vetting that is quick, and nothing hangs on it here.
fn unvetted() -> Vec<String> {
    vec!["mapping.vet=false".to_owned()]
}

fn cuts() -> u32 {
    std::env::var("ECHOFIX_POWER_CUTS")
        .map_or(30, |text| text.parse().expect("ECHOFIX_POWER_CUTS is a number"))
}

/// What became of a service's uploads over power cuts.
#[derive(Debug, Default)]
struct Outcome {
    acknowledged: usize,
    lost: Vec<u32>,
    /// Starts that failed.
    unopenable: u32,
}

/// Uploads and cuts the power again and again; a defect ends it.
async fn with_cuts(fault: Option<&'static str>) -> Outcome {
    let seed = town::seed();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let uploads = Arc::new(Uploads::new(seed));
    let mut disk = Disk::new();
    let mut known = Acknowledgements::default();
    let mut outcome = Outcome::default();
    for round in 0..cuts() {
        let from = uploads.fresh();
        let setup = Setup {
            data_dir: Some(disk.path().join("data")),
            fault,
            settings: unvetted(),
            ..Setup::default()
        };
        let mut service = Service::start_as(setup);
        let moment = Duration::from_millis(rng.random_range(5..250));
        known
            .until_gone(&uploads, &mut service, async |service| {
                tokio::time::sleep(moment).await;
                service.kill();
                disk.cut();
            })
            .await;
        drop(service);
        let setup =
            Setup { data_dir: Some(disk.path().join("data")), settings: unvetted(), ..Setup::default() };
        let mut service = Service::launch_as(setup);
        if !service.becomes_ready() {
            outcome.unopenable += 1;
            break;
        }
        let from = if round + 1 == cuts() { 0 } else { from };
        outcome.lost.extend(known.judge(&uploads, &service, from).await);
        mapping::folded(&service).await;
        tiles::all(&service).await;
        service.ask_to_end();
        assert!(service.ended().success());
        if !outcome.lost.is_empty() {
            break;
        }
    }
    outcome.acknowledged = known.answers.len();
    eprintln!("{} power cuts at most, {outcome:?}", cuts());
    outcome
}

/// Catches an acknowledgement before the disk has the upload, and a directory entry that was not synced.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs root and loop devices"]
async fn no_power_cut_loses_an_acknowledged_upload() {
    let outcome = with_cuts(None).await;
    assert_eq!((outcome.lost.len(), outcome.unopenable), (0, 0), "{outcome:?}");
    assert!(outcome.acknowledged > 100, "{outcome:?}");
}

/// Shows that the test above would notice: without the sync a power cut loses uploads.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs root and loop devices"]
async fn a_service_that_acknowledges_before_it_syncs_is_caught() {
    let outcome = with_cuts(Some("ack-before-sync")).await;
    assert!(!outcome.lost.is_empty() || outcome.unopenable > 0, "{outcome:?}");
}

/// Shows it again with what one might trust: records that sled's `flush()` acknowledged.
#[test]
#[ignore = "needs root and loop devices"]
fn a_store_that_acknowledges_on_the_flush_of_sled_is_caught() {
    let mut rng = ChaCha8Rng::seed_from_u64(town::seed());
    let mut disk = Disk::new();
    let mut acknowledged = BTreeSet::new();
    for cut in 1..=cuts() {
        let moment = Duration::from_millis(rng.random_range(20..300));
        acknowledged.extend(written(&mut disk, moment));
        let found = Command::new(STORE).arg("read").arg(disk.path().join("sled")).output().unwrap();
        let lines = String::from_utf8_lossy(&found.stdout);
        let found_numbers: BTreeSet<u64> = lines.lines().map(|line| line.parse().unwrap()).collect();
        let lost = acknowledged.difference(&found_numbers).count();
        if !found.status.success() || lost > 0 {
            eprintln!(
                "after {cut} power cuts: opens {}, {lost} of {} lost",
                found.status.success(),
                acknowledged.len()
            );
            return;
        }
    }
    panic!("{} records survived {} power cuts", acknowledged.len(), cuts());
}

/// Writes until the power is cut; returns what was acknowledged.
fn written(disk: &mut Disk, moment: Duration) -> BTreeSet<u64> {
    let mut writer = Command::new(STORE);
    writer.arg("write").arg(disk.path().join("sled")).stdout(Stdio::piped());
    let mut writer = writer.spawn().expect("the store can be run");
    let lines = BufReader::new(writer.stdout.take().expect("it is piped")).lines();
    let reader = std::thread::spawn(move || {
        lines.map_while(Result::ok).map(|l| l.parse().expect("a number a line")).collect()
    });
    std::thread::sleep(moment);
    writer.kill().expect("the store can be killed");
    writer.wait().expect("the store is ours to wait for");
    disk.cut();
    reader.join().expect("the reader does not panic")
}
