//! kill -9 at any time: what was acknowledged is there, once.
//!
//! `ECHOFIX_KILLS=1000` makes the long run of it.

use std::sync::Arc;
use std::time::Duration;

use echofix_tests::service::{Service, Setup};
use echofix_tests::tiles::Tiles;
use echofix_tests::traffic::{Acknowledgements, Uploads};
use echofix_tests::{grpc, mapping, tiles, town};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn kills() -> u32 {
    std::env::var("ECHOFIX_KILLS").map_or(50, |text| text.parse().expect("ECHOFIX_KILLS is a number"))
}

/// Uploads, kills and starts again; returns what was lost up to the first loss, if `until_lost`, or in all.
async fn killed(
    setup: Setup,
    kills: u32,
    until_lost: bool,
) -> (Service, Arc<Uploads>, Acknowledgements, Vec<u32>) {
    let seed = town::seed();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let uploads = Arc::new(Uploads::new(seed));
    let mut service = Service::start_as(setup);
    let mut known = Acknowledgements::default();
    let mut lost = Vec::new();
    for round in 0..kills {
        let from = uploads.fresh();
        let moment = Duration::from_millis(rng.random_range(5..60));
        known
            .until_gone(&uploads, &mut service, async |service| {
                tokio::time::sleep(moment).await;
                service.kill();
            })
            .await;
        if round % 3 == 0 {
            // Again, while it recovers.
            service.launch_again();
            tokio::time::sleep(Duration::from_millis(rng.random_range(0..120))).await;
            service.kill();
        }
        service.start_again();
        // Those of this round; all of them once more at the end.
        let from = if round + 1 == kills { 0 } else { from };
        lost.extend(known.judge(&uploads, &service, from).await);
        if until_lost && !lost.is_empty() {
            break;
        }
    }
    (service, uploads, known, lost)
}

/// Catches an acknowledgement before the journal has it, a torn write that is not cut off or cuts off too much, and
/// a fold that is lost or done twice.
#[tokio::test(flavor = "multi_thread")]
async fn no_kill_loses_an_acknowledged_upload() {
    let (service, uploads, known, lost) = killed(Setup::default(), kills(), false).await;
    eprintln!("{} kills, {} uploads acknowledged, {} lost", kills(), known.answers.len(), lost.len());
    assert_eq!(lost, [0; 0], "of {} acknowledged uploads these are lost", known.answers.len());
    let crashed = (mapping::folded(&service).await, tiles::but_lineage(tiles::all(&service).await));
    assert_eq!(crashed.0 as usize, known.answers.len(), "a record for each upload");
    assert!(crashed == undisturbed(&uploads, &known).await, "a crash leaves no trace in the map");
}

/// The map of the same uploads in the same order on a service that never crashes.
async fn undisturbed(uploads: &Uploads, known: &Acknowledgements) -> (u64, Tiles) {
    let service = Service::start();
    let mut client = grpc::mapping(&service).await;
    let mut numbers: Vec<_> = known.answers.iter().map(|(number, answer)| (answer.epoch, *number)).collect();
    numbers.sort_unstable();
    for (_, number) in numbers {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("the upload is acknowledged");
    }
    (mapping::folded(&service).await, tiles::but_lineage(tiles::all(&service).await))
}

/// Shows that the test above would notice: a service that acknowledges before it writes is caught.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_acknowledges_before_it_writes_is_caught() {
    let broken = Setup { fault: Some("ack-before-write"), ..Setup::default() };
    let (_, _, known, lost) = killed(broken, kills(), true).await;
    eprintln!("{} uploads acknowledged, {} lost", known.answers.len(), lost.len());
    assert!(!lost.is_empty(), "{} acknowledged uploads, none lost", known.answers.len());
}
