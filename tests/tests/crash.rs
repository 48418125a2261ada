//! kill -9 at any time: what was acknowledged is there, once.
//!
//! `ECHOFIX_KILLS=1000` makes the long run of it.

use std::sync::Arc;
use std::time::Duration;

use echofix_core::tile;
use echofix_tests::service::{Service, Setup};
use echofix_tests::traffic::{Acknowledgements, Uploads};
use echofix_tests::{mapping, tiles, town};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn kills() -> u32 {
    std::env::var("ECHOFIX_KILLS").map_or(50, |text| text.parse().expect("ECHOFIX_KILLS is a number"))
}

/// Uploads, kills and starts again; returns what was lost up to the first loss, if `until_lost`, or in all.
async fn killed(setup: Setup, kills: u32, until_lost: bool) -> (Service, Acknowledgements, Vec<u32>) {
    let seed = town::seed();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let uploads = Arc::new(Uploads::new(seed));
    let mut service = Service::start_as(setup);
    let mut known = Acknowledgements::default();
    let mut lost = Vec::new();
    for round in 0..kills {
        let from = uploads.fresh();
        let moment = Duration::from_millis(rng.random_range(5..250));
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
    (service, known, lost)
}

/// Catches an acknowledgement before the journal has it, a torn write that is not cut off or cuts off too much, and
/// a fold that is lost or done twice.
#[tokio::test(flavor = "multi_thread")]
async fn no_kill_loses_an_acknowledged_upload() {
    let (service, known, lost) = killed(Setup::default(), kills(), false).await;
    eprintln!("{} kills, {} uploads acknowledged, {} lost", kills(), known.answers.len(), lost.len());
    assert_eq!(lost, [0; 0], "of {} acknowledged uploads these are lost", known.answers.len());
    mapping::settled(&service).await;
    let tiles = tiles::all(&service).await;
    let hits = |encoded: &Vec<u8>| -> u64 {
        let tile = tile::decode(encoded).expect("a served tile decodes");
        tile.cells().iter().map(|(_, cell)| u64::from(cell.hits)).sum()
    };
    let shown: u64 = tiles.values().map(|(_, encoded)| hits(encoded)).sum();
    assert_eq!(shown, known.detections(), "each detection is counted once");
}

/// Shows that the test above would notice: a service that acknowledges before it writes is caught.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_acknowledges_before_it_writes_is_caught() {
    let broken = Setup { fault: Some("ack-before-write"), ..Setup::default() };
    let (_, known, lost) = killed(broken, kills(), true).await;
    eprintln!("{} uploads acknowledged, {} lost", known.answers.len(), lost.len());
    assert!(!lost.is_empty(), "{} acknowledged uploads, none lost", known.answers.len());
}
