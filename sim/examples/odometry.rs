//! What odometry that errs does to fixes: `cargo run -p echofix-sim --example odometry [TOWNS] [CASE]`.
//!
//! Towns as hard as the paper's, surveyed on one day by one vehicle and driven three days later by another. Every
//! batch of 5 s is asked with and without the correction by radial speeds. A case is a kind of error: drift, mounts
//! that are turned, jumps. *Beyond* are usable fixes whose error exceeds a protection level at a risk of 1e-3.
#![expect(clippy::print_stdout, reason = "printing is what this program is for")]

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::Arc;

use echofix_core::align::verdict::{Integrity, Verdict};
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, EngineKind, Prior, Search, Task};
use echofix_core::batch::Batch;
use echofix_core::doppler::dedrift::{OdometryBias, dedrifted};
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::evidence::{EvidenceAccumulator, Pass};
use echofix_core::gate::Gate;
use echofix_core::geo::{Grid, TileId, Zone};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_core::scan::{Mount, Scan};
use echofix_core::tile::{Ledger, Tile};
use echofix_core::time::DAY_US;
use echofix_core::window::MapSquare;
use echofix_sim::{
    City, DeadReckoning, Drift, DriveParams, Growth, OdometryModel, RadarSpec, Route, downtown, simulate,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// A map, and a drive on it.
struct World {
    seed: u64,
    tiles: BTreeMap<TileId, Arc<TileWeights>>,
    drive: Drive,
    truth: Trajectory,
    scale: f64,
    zone: Zone,
}

fn on_grid(grid: &Grid, poses: &[GeoPose]) -> Result<Trajectory> {
    let mut way = Trajectory::default();
    for pose in poses {
        way.push(pose.time_us, grid.pose_from_geodetic(pose.at, pose.yaw_rad)?)?;
    }
    Ok(way)
}

/// The map of these drives, each of another contributor.
fn map_of(grid: &Grid, drives: &[Drive]) -> Result<BTreeMap<TileId, Arc<TileWeights>>> {
    let mut tiles: BTreeMap<TileId, Tile> = BTreeMap::new();
    for (contributor, drive) in (0..).zip(drives) {
        let poses = on_grid(grid, &drive.reference)?;
        let scale = grid.scale_factor(drive.reference[0].at)?;
        let (first_us, last_us) = (poses.first().map(|p| p.0), poses.last().map(|p| p.0));
        let within = |s: &&Scan| Some(s.time_us) >= first_us && Some(s.time_us) <= last_us;
        let scans: Vec<_> = drive.scans.iter().filter(within).cloned().collect();
        let mut evidence = EvidenceAccumulator::default();
        evidence.add(grid.zone(), &scans, &drive.mounts, &poses, scale, &Gate::default())?;
        let pass = Pass { day: (drive.reference[0].time_us / DAY_US) as u16, contributor };
        for (id, part) in evidence.finish(0).tiles {
            tiles.entry(id).or_default().fold(&mut Ledger::default(), pass, &part);
        }
    }
    let weights = |id: &TileId| (*id, Arc::new(TileWeights::new(*id, |at| tiles.get(&at))));
    Ok(tiles.keys().map(weights).collect())
}

/// The radars of a vehicle: the paper's, or one dense radar ahead.
fn radars(kind: &str, base: &DriveParams) -> Vec<RadarSpec> {
    if kind != "dense" {
        return base.radars.clone();
    }
    let mut radar = base.radars[0].clone();
    radar.fields = RadarSpec::srr2(1.0).fields;
    (radar.sensitivity, radar.max_detections, radar.rate_hz) = (20.0, 1000, 15.0);
    radar.noise.range_m = 0.15;
    vec![radar]
}

fn world(seed: u64, kind: &str) -> Result<World> {
    let city = City::generate(&downtown::city(seed))?;
    let base = downtown::drive();
    let params = |day: u32, seed| DriveParams {
        seed,
        radars: radars(kind, &base),
        start_time_us: base.start_time_us + i64::from(day) * DAY_US,
        odometry: OdometryModel::Perfect,
        ..base.clone()
    };
    let route = Route::survey(&city, seed);
    let survey = simulate(&city.on_day(0), &route, &params(0, seed * 1000))?;
    let drive = simulate(&city.on_day(3), &route, &params(3, seed * 1000 + 999))?;
    let grid = Grid::of(drive.truth[0].at)?;
    let scale = grid.scale_factor(drive.truth[0].at)?;
    let tiles = map_of(&grid, &[survey])?;
    Ok(World { seed, tiles, truth: on_grid(&grid, &drive.truth)?, drive, scale, zone: grid.zone() })
}

/// Odometry that errs: of the true way, the reference time and a seed.
type Errs = Box<dyn Fn(&Trajectory, i64, u64) -> Result<Trajectory>>;

/// A kind of error.
struct Case {
    name: &'static str,
    /// By how much the mounts are turned from what is declared, radians.
    mounts_rad: f64,
    /// Whether radial speeds correct the odometry.
    doppler: bool,
    /// The odometry: the true way, the reference time and a seed.
    errs: Errs,
}

fn jump(at_us: i64, by_m: f64, way: &Trajectory) -> Result<Trajectory> {
    // Ahead along the heading at the jump, as a reset is.
    let Some(at) = way.at(at_us) else { return Ok(way.clone()) };
    let ahead = at.compose(&Pose2::new(by_m, 0.0, 0.0));
    let shifted = |(t, p): (i64, Pose2)| {
        if t >= at_us { (t, ahead.compose(&at.between(&p))) } else { (t, p) }
    };
    Ok(Trajectory::new(way.iter().map(shifted))?)
}

fn cases() -> Vec<Case> {
    let case = |name, mounts_deg: f64, doppler, errs: Errs| Case {
        name,
        mounts_rad: mounts_deg.to_radians(),
        doppler,
        errs,
    };
    let exact = || Box::new(|way: &Trajectory, _: i64, _: u64| Ok(way.clone()));
    let paper = |growth| {
        let drift = Drift::over_5_s(Drift::PAPER_LEVELS[2], growth);
        Box::new(move |way: &Trajectory, _: i64, seed: u64| Ok(drift.apply(way, seed)?))
    };
    let car = || {
        Box::new(|way: &Trajectory, _: i64, seed: u64| {
            let truth: Vec<_> = way.iter().collect();
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            Ok(OdometryModel::DeadReckoning(DeadReckoning::default()).observe(&truth, &mut rng)?)
        })
    };
    let jumps = |before_us: i64, by_m: f64| {
        Box::new(move |way: &Trajectory, end_us: i64, _: u64| jump(end_us - before_us, by_m, way))
    };
    let mut all = Vec::new();
    for doppler in [true, false] {
        let name = |with: &'static str, without: &'static str| if doppler { with } else { without };
        all.push(case(name("exact", "exact-raw"), 0.0, doppler, exact()));
        all.push(case(name("car", "car-raw"), 0.0, doppler, car()));
        all.push(case(name("linear", "linear-raw"), 0.0, doppler, paper(Growth::Linear)));
        all.push(case(name("quadratic", "quadratic-raw"), 0.0, doppler, paper(Growth::Quadratic)));
        all.push(case(name("turned", "turned-raw"), 0.5, doppler, exact()));
        all.push(case(name("jump5", "jump5-raw"), 0.0, doppler, jumps(500_000, 5.0)));
        all.push(case(name("jump1", "jump1-raw"), 0.0, doppler, jumps(200_000, 1.0)));
        all.push(case(name("jump3", "jump3-raw"), 0.0, doppler, jumps(1_700_000, 3.0)));
        all.push(case(name("jumpback2", "jumpback2-raw"), 0.0, doppler, jumps(3_000_000, -2.0)));
    }
    all
}

/// What came of a case.
#[derive(Default)]
struct Tally {
    asked: usize,
    usable: usize,
    beyond: usize,
    wrong: usize,
    metres: Vec<f64>,
    degrees: Vec<f64>,
    nees: [f64; 3],
    verdicts: BTreeMap<String, usize>,
}

impl Tally {
    fn print(mut self, name: &str) {
        let at = |all: &mut Vec<f64>, q: f64| {
            all.sort_by(f64::total_cmp);
            all.get(((all.len() as f64 - 1.0) * q).max(0.0) as usize).copied().unwrap_or(f64::NAN)
        };
        let n = self.metres.len().max(1) as f64;
        let [along, across, yaw] = self.nees.map(|s| s / n);
        println!(
            "| {name} | {} | {:.1} | {} | {} | {:.3} | {:.3} | {:.3} | {along:.2} | {across:.2} | {yaw:.2} | {:?}",
            self.asked,
            100.0 * self.usable as f64 / self.asked.max(1) as f64,
            self.wrong,
            self.beyond,
            at(&mut self.metres, 0.5),
            at(&mut self.metres, 0.95),
            at(&mut self.degrees, 0.95),
            self.verdicts
        );
    }
}

fn part(way: &Trajectory, from_us: i64, to_us: i64) -> Result<Trajectory> {
    let mut part = way.clone();
    part.trim_before(from_us);
    part.trim_after(to_us);
    Ok(Trajectory::new(part.iter())?)
}

fn ask(
    world: &World,
    case: &Case,
    end_us: i64,
    seed: u64,
    aligner: &mut Aligner,
    tally: &mut Tally,
) -> Result<()> {
    let start_us = end_us - 5_000_000;
    let exact = part(&world.drive.odometry, start_us, end_us)?;
    let way = (case.errs)(&exact, end_us, seed)?;
    let turned = |m: &Mount| Mount::new(m.x_m, m.y_m, m.yaw_rad - case.mounts_rad);
    let mounts: Vec<_> = world.drive.mounts.iter().map(turned).collect();
    let scans = &world.drive.scans;
    let seen = &scans
        [scans.partition_point(|s| s.time_us <= start_us)..scans.partition_point(|s| s.time_us <= end_us)];
    let found = case
        .doppler
        .then(|| dedrifted(seen, &mounts, &way, &EgoConfig::default(), &OdometryBias::default()))
        .flatten();
    let quality = found.as_ref().map_or_else(Default::default, |found| found.quality);
    let way = found.map_or(way, |found| found.trajectory);
    let mut batch = Batch::organise(seen, &mounts, &way, end_us, &Gate::default())?;
    batch.quality = quality;
    let Some(truth) = world.truth.at(end_us) else { return Ok(()) };
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = |sigma: f64| -> f64 {
        sigma * {
            let n: f64 = StandardNormal.sample(&mut rng);
            n
        }
    };
    let (sigma_position_m, sigma_yaw_rad) = (2.0, 3_f64.to_radians());
    let pose = Pose2::new(
        truth.x_m + normal(sigma_position_m),
        truth.y_m + normal(sigma_position_m),
        truth.yaw_rad + normal(sigma_yaw_rad),
    );
    let prior = Prior { pose, sigma_position_m, sigma_yaw_rad, scale: world.scale };
    let (search, integrity) = (Search::default(), Integrity::default());
    let square = MapSquare::around(world.zone, MapPoint::of(&pose), search.extent_m, 6.0);
    let tiles: Vec<_> = square.tiles().filter_map(|id| world.tiles.get(&id).cloned()).collect();
    let task = Task { square, tiles: &tiles, batch: &batch, prior: &prior };
    let answer = aligner.align(&task, EngineKind::Fast.engine(), &search, &integrity);
    tally.asked += 1;
    let word = format!("{:?}", answer.verdict);
    let word = word.split([' ', '{']).next().unwrap_or_default().to_owned();
    *tally.verdicts.entry(word).or_default() += 1;
    if answer.verdict != Verdict::Usable {
        return Ok(());
    }
    tally.usable += 1;
    let off = truth.between(&answer.pose);
    let levels = answer.protection(&integrity, 1e-3);
    let yaw = wrap_angle(off.yaw_rad);
    let metres = off.x_m.hypot(off.y_m);
    tally.wrong += usize::from(metres > 1.0);
    tally.beyond += usize::from(
        off.x_m.abs() > levels.along_m || off.y_m.abs() > levels.cross_m || yaw.abs() > levels.yaw_rad,
    );
    tally.metres.push(metres);
    tally.degrees.push(yaw.abs().to_degrees());
    let one = answer.protection(&Integrity { tail: 1.0, ..integrity }, (-0.5_f64).exp());
    for (sum, (error, sigma)) in
        tally.nees.iter_mut().zip([(off.x_m, one.along_m), (off.y_m, one.cross_m), (yaw, one.yaw_rad)])
    {
        *sum += (error / sigma).powi(2);
    }
    Ok(())
}

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let towns: u64 = args.next().and_then(|n| n.parse().ok()).unwrap_or(1);
    let only: Vec<String> = args.collect();
    let kind = if only.iter().any(|a| a == "dense") { "dense" } else { "paper" };
    let worlds: Vec<World> = (1..=towns).map(|i| world(30 + i, kind)).collect::<Result<_>>()?;
    println!(
        "| case | asked | usable % | > 1 m | beyond | 50 % m | 95 % m | 95 % deg | NEES along | across | yaw |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for case in cases() {
        let named = only.iter().filter(|a| *a != "dense");
        if named.clone().count() > 0 && !named.clone().any(|a| a == case.name) {
            continue;
        }
        let (mut tally, mut aligner) = (Tally::default(), Aligner::default());
        for world in &worlds {
            let Some((first_us, _)) = world.drive.odometry.first() else { continue };
            let Some((last_us, _)) = world.drive.odometry.last() else { continue };
            let mut next_us = first_us + 8_000_000;
            let mut rested_us = first_us;
            for scan in &world.drive.scans {
                let v = world.drive.odometry.velocity_at(scan.time_us).map_or(0.0, |v| v.speed_mps());
                if v <= 1.0 {
                    rested_us = scan.time_us;
                }
                if scan.time_us < next_us || scan.time_us - rested_us < 1_000_000 || scan.time_us >= last_us {
                    continue;
                }
                next_us = scan.time_us + 2_500_000;
                let seed = world.seed * 100_000 + scan.time_us as u64 / 1000 % 100_000;
                ask(world, &case, scan.time_us, seed, &mut aligner, &mut tally)?;
            }
        }
        tally.print(case.name);
    }
    Ok(())
}
