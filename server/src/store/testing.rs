//! Uploads for tests.

use echofix_core::datum::PoseSigma;
use echofix_core::evidence::{CellHits, EvidenceDelta, Pass, TileEvidence, VIEW_BLOCKS};
use echofix_core::geo::{TileId, Zone};
use proptest::prelude::*;
use uuid::Uuid;

use crate::store::api::UploadRecord;

/// Uploads of few contributors to few tiles, so that they meet.
pub(crate) fn uploads() -> impl Strategy<Value = UploadRecord> {
    let tile = (0..3_i32, -1..2_i32, any::<bool>()).prop_map(|(x, y, south)| {
        let zone = Zone::from_epsg(if south { 32714 } else { 32614 }).unwrap();
        TileId { zone, y, x }
    });
    let hits = |(index, hits): (u32, u32)| CellHits { index, hits, offset_sum: [hits * 3, hits * 200] };
    let cells = prop::collection::btree_map(0..300_u32, 1..4_u32, 1..20)
        .prop_map(move |cells| cells.into_iter().map(hits).collect::<Vec<_>>());
    let evidence = (cells, 0..VIEW_BLOCKS).prop_map(|(cells, seen)| {
        let mut evidence = TileEvidence::of_hits(cells);
        evidence.observed.insert(seen);
        evidence
    });
    let tiles = prop::collection::btree_map(tile, evidence, 1..5);
    let pass = (20_000..20_003_u16, 0..3_u64).prop_map(|(day, contributor)| Pass { day, contributor });
    let sigma = (0.01..0.3_f64, 0.001..0.01_f64).prop_map(|(m, rad)| PoseSigma::declared(m, rad));
    let declared = prop::option::of(prop_oneof![Just(PoseSigma::default()), sigma]);
    (any::<u128>(), pass, tiles, any::<Vec<u8>>(), declared).prop_map(
        |(id, pass, tiles, answer, declared)| {
            let detections = tiles.values().map(TileEvidence::detections).sum();
            let contribution = EvidenceDelta { tiles, detections };
            UploadRecord { id: Uuid::from_u128(id), pass, forget_before: 0, declared, contribution, answer }
        },
    )
}

/// The same uploads in every run.
pub(crate) fn some_uploads(count: usize) -> Vec<UploadRecord> {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    (0..count).map(|_| uploads().new_tree(&mut runner).unwrap().current()).collect()
}
