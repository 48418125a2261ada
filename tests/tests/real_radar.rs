//! Real radar data through the command. The data is not in the repository: `ECHOFIX_DATA_DIR` names
//! the folder that holds `radiate_tiny_foggy` and `comma2k19_example`, then
//!
//! ```text
//! ECHOFIX_DATA_DIR=... cargo test -p echofix-tests --test real_radar -- --ignored
//! ```

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use echofix_client::import::radiate;
use echofix_core::align::engine::{Bounded, Engine, Fast, Fft, Reference};
use echofix_core::align::pipeline::Pipeline;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Prior, Search};
use echofix_core::batch::Batch;
use echofix_core::drive::Drive;
use echofix_core::evidence::{EvidenceAccumulator, Pass, TileEvidence};
use echofix_core::gate::Gate;
use echofix_core::geo::{Grid, TileId};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use echofix_core::tile::{Ledger, Tile};
use echofix_core::window::MapSquare;
use echofix_sim::rng::normal;
use echofix_tests::asking::percentile;
use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

fn data(name: &str) -> String {
    let folder =
        std::env::var_os("ECHOFIX_DATA_DIR").expect("ECHOFIX_DATA_DIR names the folder with the data");
    PathBuf::from(folder).join(name).to_str().expect("the path is Unicode").to_owned()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// An imported set: the service to map it with, the log, the spool.
fn imported(service: Service, kind: &str, folder: &str) -> (Service, String, String) {
    let path = |name: &str| service.scratch().join(name).to_str().expect("the path is Unicode").to_owned();
    let (log, spool) = (path("drive.mcap"), path("spool"));
    let imported = echofix(["import", kind, &data(folder), &log, "--json"]).json();
    eprintln!("{imported}");
    (service, log, spool)
}

/// A spinning radar in fog: the first nine scans make the map, the next nine find themselves in it.
/// Catches a frame, a sign or a unit that the simulator and the service get wrong in the same way.
#[test]
#[ignore = "needs ECHOFIX_DATA_DIR"]
fn radiate_scans_find_themselves_in_the_map_of_the_scans_before() {
    let (service, log, spool) = imported(Service::start(), "radiate", "radiate_tiny_foggy");
    let mapped =
        echofix(["map", &log, "--server", &service.grpc, "--spool", &spool, "--scans", "1-9", "--json"])
            .json();
    eprintln!("{mapped}");
    assert!(
        number(&mapped["result"]["detections"]) > 1_000.0 && mapped["result"]["refused"] == 0,
        "{mapped}"
    );
    let localized = echofix([
        "localize",
        &log,
        "--server",
        &service.grpc,
        "--scans",
        "10-18",
        "--every-s",
        "0",
        "--batch-s",
        "5",
        "--warm-up-s",
        "0",
        "--priors",
        "50",
        "--sigma-position-m",
        "2",
        "--sigma-yaw-deg",
        "3",
        "--json",
    ])
    .json();
    let summary = &localized["summary"];
    eprintln!("{summary:#}");
    assert!(number(&summary["asked"]) >= 100.0, "{summary:#}");
    // Usable or not: the best pose is the right one.
    assert!(number(&summary["error_all_m"]["p95"]) < 0.5, "{summary:#}");
    assert!(number(&summary["error_yaw_all_deg"]["p95"]) < 1.0, "{summary:#}");
    assert_eq!(summary["beyond_protection"], 0, "{summary:#}");
}

/// A car's radar on a highway, which gives tracks of other cars and hardly any structure: movers are
/// dropped and counted, and what is left is never called usable.
#[test]
#[ignore = "needs ECHOFIX_DATA_DIR"]
fn comma2k19_movers_are_dropped_and_too_little_is_never_usable() {
    let loose = ["mapping.max_sigma_position_m=0.6", "mapping.max_sigma_yaw_deg=1"];
    let (service, log, spool) = imported(Service::start_with(&loose), "comma2k19", "comma2k19_example");
    // Its poses are known to half a metre and a degree: not well enough for the default limits.
    let arguments = ["map", &log, "--server", &service.grpc, "--spool", &spool, "--json"];
    let strict = echofix(arguments);
    assert!(strict.json_error().contains("without a good pose"), "{strict:?}");
    let mapped =
        echofix(arguments.iter().chain(&["--max-sigma-m", "0.6", "--max-sigma-yaw-deg", "1"])).json();
    eprintln!("{mapped}");
    let (mapped_count, moving) =
        (number(&mapped["result"]["detections"]), number(&mapped["result"]["left_out"]["moving"]));
    // Some 8 tracks a cycle, little more than one of them stationary.
    assert!(
        mapped_count > 0.0 && moving > 3.0 * mapped_count && mapped["result"]["refused"] == 0,
        "{mapped}"
    );
    let localized = echofix(["localize", &log, "--server", &service.grpc, "--every-s", "2", "--json"]).json();
    let summary = &localized["summary"];
    eprintln!("{summary:#}");
    assert!(number(&summary["asked"]) > 0.0 && number(&summary["usable_share"]).abs() < 1e-12, "{summary:#}");
}

/// The fragment: its first nine scans as a map, the next nine to be found in it.
struct Fragment {
    drive: Drive,
    grid: Grid,
    truth: Trajectory,
    scale: f64,
    tiles: BTreeMap<TileId, Tile>,
}

/// Scans that make the map; the others are searched for.
const MAPPED: usize = 9;
/// Priors for each batch: the reference takes seconds for one.
const PRIORS: usize = 2;

impl Fragment {
    fn read() -> Self {
        let drive = radiate(data("radiate_tiny_foggy")).expect("the fragment can be read");
        let grid = Grid::of(drive.truth[0].at).expect("Edinburgh lies inside UTM");
        let scale = grid.scale_factor(drive.truth[0].at).expect("Edinburgh lies inside UTM");
        let on_grid = drive.truth.iter().map(|p| {
            (p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad).expect("Edinburgh lies inside UTM"))
        });
        let truth = Trajectory::new(on_grid).expect("the poses are in order");
        let (scans, gate) = (&drive.scans[..MAPPED], Gate::default());
        let mut gathering = EvidenceAccumulator::default();
        let (detections, _) = gathering
            .add(grid.zone(), scans, &drive.mounts, &truth, scale, &gate)
            .expect("the radar is mounted");
        let seen = gathering.finish(detections);
        let fold = |evidence: &TileEvidence| {
            let (mut tile, mut ledger) = (Tile::default(), Ledger::default());
            tile.fold(&mut ledger, Pass { day: 20_000, contributor: 1 }, evidence);
            tile
        };
        let tiles = seen.tiles.iter().map(|(id, evidence)| (*id, fold(evidence))).collect();
        Self { drive, grid, truth, scale, tiles }
    }

    /// The batch that ends with a scan, and where it was taken.
    fn batch(&self, last: usize) -> (Batch, Pose2) {
        let (scans, time_us) = (&self.drive.scans[MAPPED..=last], self.drive.scans[last].time_us);
        let Drive { mounts, odometry, .. } = &self.drive;
        let batch = Batch::organise(scans, mounts, odometry, time_us, &Gate::default());
        let at = self.truth.at(time_us).expect("the poses cover the scans");
        (batch.expect("the odometry covers the scans"), at)
    }

    fn weights(&self, frame: &MapSquare) -> Vec<Arc<TileWeights>> {
        let known = frame.tiles().filter(|id| self.tiles.contains_key(id));
        known.map(|id| Arc::new(TileWeights::new(id, |at| self.tiles.get(&at)))).collect()
    }
}

/// What an engine found for each question.
#[derive(Default)]
struct Row {
    name: &'static str,
    maxima: Vec<(Pose2, f64)>,
    /// Of the best hypothesis, which is rounded to cells and degrees: metres, radians.
    errors: Vec<[f64; 2]>,
}

/// Real echoes through every engine. Catches an engine that is exact on made-up scenes only: on walls that
/// are not straight, speckle and fog; breaks when a bound is one too low or a transform too coarse.
#[test]
#[ignore = "needs ECHOFIX_DATA_DIR"]
fn every_exact_engine_finds_the_same_maximum_in_radiate_scans() {
    let fragment = Fragment::read();
    let engines: [&dyn Engine; 4] = [&Reference::default(), &Fft, &Bounded::BEST, &Fast::BEST];
    let mut rows = engines.map(|e| Row { name: e.name(), ..Row::default() });
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let mut pipeline = Pipeline::default();
    let search = Search::default();
    for last in MAPPED..fragment.drive.scans.len() {
        let (batch, truth) = fragment.batch(last);
        pipeline.thin(&batch.points, search.extent_m);
        for _ in 0..PRIORS {
            let (sigma_position_m, sigma_yaw_rad) = (2.0, 3_f64.to_radians());
            let [east_m, north_m] = [0, 1].map(|_| normal(&mut rng, sigma_position_m));
            let turn = normal(&mut rng, sigma_yaw_rad);
            let pose = Pose2::new(truth.x_m + east_m, truth.y_m + north_m, truth.yaw_rad + turn);
            let prior = Prior { pose, sigma_position_m, sigma_yaw_rad, scale: fragment.scale };
            let frame = MapSquare::around(fragment.grid.zone(), MapPoint::of(&pose), search.extent_m, 6.0);
            pipeline.assemble(frame, &fragment.weights(&frame));
            for (engine, row) in engines.into_iter().zip(&mut rows) {
                let found = pipeline.search(engine, &batch, &prior, &search);
                let top = found.first().expect("an engine finds something");
                row.maxima.push((top.correction, top.score));
                let found = prior.corrected(&top.correction);
                row.errors.push([found.distance_m(&truth), (found.yaw_rad - truth.yaw_rad).abs()]);
            }
        }
    }
    print_table(&rows);
    let [reference, fft, bounded, fast] = &rows;
    assert_eq!(fft.maxima, reference.maxima);
    assert_eq!(bounded.maxima, reference.maxima);
    // It counts thinned points: its maximum is another sum's, and near it.
    for (found, exact) in fast.maxima.iter().zip(&reference.maxima) {
        assert!(found.0.distance_m(&exact.0) < 0.5, "{found:?} {exact:?}");
    }
}

fn print_table(rows: &[Row]) {
    let exact = &rows[0].maxima;
    eprintln!("| engine | reference's maximum | error p50 | p95 | worst | heading p95 |");
    eprintln!("|---|---|---|---|---|---|");
    for row in rows {
        let same = row.maxima.iter().zip(exact).filter(|(a, b)| a.0 == b.0).count();
        let of = |value: fn(&[f64; 2]) -> f64, fraction| percentile(row.errors.iter().map(value), fraction);
        eprintln!(
            "| {} | {same} of {} | {:.2} m | {:.2} m | {:.2} m | {:.2} deg |",
            row.name,
            exact.len(),
            of(|e| e[0], 0.5),
            of(|e| e[0], 0.95),
            of(|e| e[0], 1.0),
            of(|e| e[1], 0.95).to_degrees()
        );
    }
}
