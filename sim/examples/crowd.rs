//! Uploads of a crowd, vetted and moved onto the map: what fixes gain by it, and what vetting catches.
//!
//! `cargo run --release -p echofix-sim --example crowd -- fixes [seed...]` compares maps folded as uploads come, vetted
//! and moved, and made from exact poses (`DAYS=1`: each contributor on a day of his own; `ALARMS=1`: what vetting
//! says of honest and of wrong uploads; `VERBOSE=1`: every quarantined one). `-- parts SEED` shows what parts measure.
#![expect(clippy::print_stdout, reason = "printing is what this program is for")]
#![expect(clippy::unwrap_used, reason = "a program for measuring, stopped by what it does not expect")]

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use echofix_core::align::verdict::Integrity;
use echofix_core::align::weights::TileWeights;
use echofix_core::align::{Aligner, EngineKind, Prior, Search, Task};
use echofix_core::batch::Batch;
use echofix_core::datum::{Datum, Offset, mean_offset};
use echofix_core::doppler;
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::evidence::{self, CellHits, Pass};
use echofix_core::geo::{Grid, TileId};
use echofix_core::odometry::Trajectory;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_core::scan::{Gate, Scan};
use echofix_core::tile::{Ledger, Tile};
use echofix_core::vetting::{Limits, MapSide, Offsets, Reason, Share, Vetted, Vetter, Voice, moved};
use echofix_core::window::Frame;
use echofix_sim::{City, DriveParams, OdometryModel, Route, downtown, simulate};

const CUT_US: i64 = 10_000_000;
const CUT_M: f64 = 100.0;
const BATCH_US: i64 = 5_000_000;
const SECOND_US: i64 = 1_000_000;

/// A map that folds, plain or aligned.
#[derive(Default)]
struct Map {
    tiles: BTreeMap<TileId, Tile>,
    ledgers: BTreeMap<TileId, Ledger>,
    datums: BTreeMap<TileId, Datum>,
    counted: BTreeSet<(TileId, Pass)>,
    every: BTreeMap<TileId, Datum>,
    /// Who contributed to a tile, and who is asking: nobody is held against his own map.
    contributors: BTreeMap<TileId, BTreeSet<u64>>,
    asking: Cell<Option<u64>>,
    prepared: RefCell<BTreeMap<TileId, Arc<TileWeights>>>,
}

impl MapSide for Map {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        let others = self.contributors.get(&id)?.iter().any(|c| Some(*c) != self.asking.get());
        if !others {
            return None;
        }
        if let Some(known) = self.prepared.borrow().get(&id) {
            return Some(Arc::clone(known));
        }
        let weights = Arc::new(TileWeights::new(id, |at| self.tiles.get(&at)));
        self.prepared.borrow_mut().insert(id, Arc::clone(&weights));
        Some(weights)
    }

    fn datum(&self, id: TileId) -> Datum {
        self.datums.get(&id).copied().unwrap_or_default()
    }
}

impl Map {
    fn fold(&mut self, pass: Pass, tiles: &BTreeMap<TileId, Vec<CellHits>>) {
        for (id, cells) in tiles {
            let ledger = self.ledgers.entry(*id).or_default();
            self.tiles.entry(*id).or_default().fold(ledger, pass, cells);
            self.contributors.entry(*id).or_default().insert(pass.contributor);
            for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
                self.prepared.borrow_mut().remove(&TileId { y: id.y + dy, x: id.x + dx, ..*id });
            }
        }
    }

    fn fold_moved(&mut self, pass: Pass, tiles: &BTreeMap<TileId, Vec<CellHits>>, offsets: &Offsets) {
        let shares = shares(tiles);
        self.fold(pass, &moved(&shares, offsets));
        for id in tiles.keys() {
            let [x, y] = id.origin();
            let at = offsets.at([x + 25.6, y + 25.6]);
            self.every.entry(*id).or_default().add(Offset::of(&at));
            if self.counted.insert((*id, pass)) {
                self.datums.entry(*id).or_default().add(Offset::of(&at));
            }
        }
    }
}

fn shares(tiles: &BTreeMap<TileId, Vec<CellHits>>) -> Vec<Share<'_>> {
    tiles.iter().map(|(id, cells)| (*id, &cells[..])).collect()
}

/// An upload: its cells, and the mean error of its poses.
struct Upload {
    pass: Pass,
    tiles: BTreeMap<TileId, Vec<CellHits>>,
    error: Pose2,
}

/// How the poses of an upload are made wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wrong {
    No,
    Shift(f64),
    Turn(f64),
    Heading(f64),
    Elsewhere(f64),
    /// Not at all: the exact poses.
    Exact,
}

struct Town {
    grid: Grid,
    drives: Vec<Drive>,
    localized: Drive,
}

fn on_grid(grid: &Grid, poses: &[GeoPose]) -> Trajectory {
    Trajectory::new(poses.iter().map(|p| (p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad).unwrap())))
        .unwrap()
}

fn town(seed: u64, contributors: usize) -> Town {
    let city = City::generate(&downtown::city(seed)).unwrap();
    let number = |vehicle: usize| seed * 1000 + vehicle as u64;
    let drive = |day: u32, route: &Route, seed: u64| {
        let base = downtown::drive();
        let params = DriveParams {
            vehicle: format!("vehicle-{seed}"),
            seed,
            start_time_us: base.start_time_us + i64::from(day) * 86_400_000_000,
            odometry: OdometryModel::Perfect,
            ..base
        };
        let mut drive = simulate(&city.on_day(day), route, &params).unwrap();
        for scan in &mut drive.scans {
            if let (Some(v), Some(mount)) =
                (drive.odometry.velocity_at(scan.time_us), drive.mounts.get(scan.sensor))
            {
                doppler::drop_movers(scan, mount, v, 0.5);
            }
        }
        drive
    };
    let days = |vehicle: usize| if std::env::var("DAYS").is_ok() { 4 + vehicle as u32 } else { 0 };
    let drives: Vec<_> =
        (0..contributors).map(|v| drive(days(v), &Route::survey(&city, number(v)), number(v))).collect();
    let localized = drive(3, &Route::survey(&city, number(0)), number(999));
    let grid = Grid::of(drives[0].truth[0].at).unwrap();
    Town { grid, drives, localized }
}

fn uploads(grid: &Grid, drive: &Drive, contributor: u64, wrong: Wrong) -> Vec<Upload> {
    let gate = Gate { max_doppler_residual_mps: f64::INFINITY, ..Gate::default() };
    let truth = on_grid(grid, &drive.truth);
    let poses = if wrong == Wrong::Exact { truth.clone() } else { on_grid(grid, &drive.reference) };
    let all: Vec<_> = poses.iter().collect();
    let mut out = Vec::new();
    let (mut from, mut way) = (0, 0.0);
    for i in 1..all.len() {
        way += all[i].1.distance_m(&all[i - 1].1);
        if all[i].0 - all[from].0 >= CUT_US || way >= CUT_M || i + 1 == all.len() {
            let part = &all[from..=i];
            out.extend(upload(grid, drive, contributor, part, &truth, &gate, wrong));
            (from, way) = (i, 0.0);
        }
    }
    out
}

fn upload(
    grid: &Grid,
    drive: &Drive,
    contributor: u64,
    part: &[(i64, Pose2)],
    truth: &Trajectory,
    gate: &Gate,
    wrong: Wrong,
) -> Option<Upload> {
    let n = part.len() as f64;
    let mut error = Pose2::IDENTITY;
    for (time, pose) in part {
        let t = truth.at(*time)?;
        error.x_m += (pose.x_m - t.x_m) / n;
        error.y_m += (pose.y_m - t.y_m) / n;
        error.yaw_rad += wrap_angle(pose.yaw_rad - t.yaw_rad) / n;
    }
    let middle = part[part.len() / 2].1;
    let direction = contributor as f64 * 2.4 + part[0].0 as f64 * 1e-6;
    let broken = |p: &Pose2| match wrong {
        Wrong::No | Wrong::Exact => *p,
        Wrong::Elsewhere(m) | Wrong::Shift(m) => {
            Pose2::new(p.x_m + m * direction.cos(), p.y_m + m * direction.sin(), p.yaw_rad)
        }
        Wrong::Turn(rad) => {
            let about = Pose2::new(middle.x_m, middle.y_m, 0.0);
            about.compose(&Pose2::new(0.0, 0.0, rad)).compose(&about.inverse()).compose(p)
        }
        Wrong::Heading(rad) => Pose2::new(p.x_m, p.y_m, p.yaw_rad + rad),
    };
    let trajectory = Trajectory::new(part.iter().map(|(t, p)| (*t, broken(p)))).unwrap();
    let a = drive.scans.partition_point(|s| s.time_us < part[0].0);
    let b = drive.scans.partition_point(|s| s.time_us < part[part.len() - 1].0);
    let scale = grid.scale_factor(drive.truth[0].at).unwrap();
    let (contribution, _) =
        evidence::contribute(grid.zone(), &drive.scans[a..b], &drive.mounts, &trajectory, scale, gate)
            .unwrap();
    let day = (part[0].0 / 86_400_000_000) as u16;
    (contribution.detections > 500).then_some(Upload {
        pass: Pass { day, contributor },
        tiles: contribution.tiles,
        error,
    })
}

/// The questions of a town: time, batch, truth.
fn questions(town: &Town, most: usize) -> Vec<(Pose2, Batch)> {
    let drive = &town.localized;
    let truth = on_grid(&town.grid, &drive.truth);
    let mut out = Vec::new();
    let (mut rested, first) = (i64::MIN, drive.scans[0].time_us);
    let mut next = first + 8 * SECOND_US;
    rested = rested.max(first);
    for scan in &drive.scans {
        let t = scan.time_us;
        if drive.odometry.velocity_at(t).map_or(0.0, |v| v.speed_mps()) <= 1.0 {
            rested = t;
        }
        if t < next || t - rested < SECOND_US {
            continue;
        }
        let Some(pose) = truth.at(t) else { continue };
        let a = drive.scans.partition_point(|s| s.time_us <= t - BATCH_US);
        let b = drive.scans.partition_point(|s| s.time_us <= t);
        let seen: &[Scan] = &drive.scans[a..b];
        if let Ok(batch) = Batch::organise(seen, &drive.mounts, &drive.odometry, t, &Gate::default()) {
            out.push((pose, batch));
        }
        next = t + SECOND_US;
    }
    let n = out.len();
    let keep = n.min(most);
    let mut chosen = Vec::new();
    for k in 0..keep {
        chosen.push(out[k * n / keep].clone());
    }
    chosen
}

/// Errors of fixes, metres and degrees: as found, less the mean of passes, less that of uploads.
fn fixes(map: &Map, town: &Town, questions: &[(Pose2, Batch)], errors: &mut [Vec<(f64, f64)>; 3]) {
    let mut aligner = Aligner::default();
    let (search, integrity) = (Search::default(), Integrity::default());
    let zone = town.grid.zone();
    let scale = town.grid.scale_factor(town.localized.truth[0].at).unwrap();
    for (i, (truth, batch)) in questions.iter().enumerate() {
        let angle = i as f64 * 2.399;
        let (x, y) = (truth.x_m + 1.5 * angle.cos(), truth.y_m + 1.5 * angle.sin());
        let pose = Pose2::new(x, y, truth.yaw_rad + 0.03 * (1.7 * angle).sin());
        let prior = Prior { pose, sigma_position_m: 2.0, sigma_yaw_rad: 3_f64.to_radians(), scale };
        let frame = Frame::around(zone, [pose.x_m, pose.y_m], 50.0, 6.0);
        let tiles: Vec<_> = frame.tiles().filter_map(|id| map.weights(id)).collect();
        let task = Task { frame, tiles: &tiles, batch, prior: &prior };
        let found = aligner.align(&task, EngineKind::Fast, &search, &integrity).pose;
        let place = [found.x_m, found.y_m];
        let every = |id| map.every.get(&id).copied().unwrap_or_default();
        let by =
            [Pose2::IDENTITY, mean_offset(zone, place, |id| map.datum(id)), mean_offset(zone, place, every)];
        for (by, k) in by.iter().zip(0..) {
            let less = Pose2::new(found.x_m - by.x_m, found.y_m - by.y_m, found.yaw_rad - by.yaw_rad);
            let turn = wrap_angle(less.yaw_rad - truth.yaw_rad).to_degrees().abs();
            errors[k].push((less.distance_m(truth), turn));
        }
    }
}

/// Errors of the poses of each drive, where they were.
fn pose_errors(town: &Town) -> Vec<Vec<(Pose2, [f64; 2])>> {
    let of = |drive: &Drive| {
        let (believed, real) = (on_grid(&town.grid, &drive.reference), on_grid(&town.grid, &drive.truth));
        let error = |(t, p): (i64, Pose2)| real.at(t).map(|r| (r, [p.x_m - r.x_m, p.y_m - r.y_m]));
        believed.iter().step_by(10).filter_map(error).collect()
    };
    town.drives.iter().map(of).collect()
}

/// Mean error of the poses that mapped a place.
fn floor(errors: &[Vec<(Pose2, [f64; 2])>], truth: &Pose2) -> f64 {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for drive in errors {
        let near: Vec<_> = drive.iter().filter(|(at, _)| at.distance_m(truth) < 50.0).collect();
        if !near.is_empty() {
            let mean = |k: usize| near.iter().map(|(_, e)| e[k]).sum::<f64>() / near.len() as f64;
            sum = [sum[0] + mean(0), sum[1] + mean(1)];
            count += 1.0;
        }
    }
    (sum[0] / count).hypot(sum[1] / count)
}

/// Milliseconds that this process has computed.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let mut fields = stat.rsplit(')').next().unwrap().split_whitespace();
    10.0 * fields.nth(11).unwrap().parse::<f64>().unwrap()
}

fn percentiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.5, 0.95, 0.99].map(|q| values[((values.len() as f64 * q) as usize).min(values.len() - 1)])
}

fn row(name: &str, errors: &[(f64, f64)]) {
    let m = percentiles(errors.iter().map(|e| e.0 * 100.0).collect());
    let d = percentiles(errors.iter().map(|e| e.1).collect());
    println!(
        "{name}: {:.1} / {:.1} / {:.1} cm; {:.3} / {:.3} / {:.3} deg",
        m[0], m[1], m[2], d[0], d[1], d[2]
    );
}

fn show(vetter: &mut Vetter, map: &Map, upload: &Upload, limits: &Limits) {
    for probed in vetter.probe(&shares(&upload.tiles), map, limits) {
        let (part, m) = (&probed.part, &probed.expected);
        let passes = map.datum(TileId::of(part.zone, part.middle)).passes;
        let Some(at) = probed.placement else {
            println!("   none, {} points", part.points.len());
            continue;
        };
        println!(
            "   {:.2} {:.2} {:.2} deg  sd {:.2} {:.2} {:.2}; points {} coverage {:.2} contrast {:.2} margin {:.0} edge {} passes {} expected {:.2} {:.2} {:.2} {}",
            at.error.x_m,
            at.error.y_m,
            at.error.yaw_rad.to_degrees(),
            at.covariance[(0, 0)].sqrt(),
            at.covariance[(1, 1)].sqrt(),
            at.covariance[(2, 2)].sqrt().to_degrees(),
            at.points,
            at.coverage,
            at.contrast,
            at.margin,
            at.at_edge,
            passes,
            m.x_m,
            m.y_m,
            m.yaw_rad.to_degrees(),
            match probed.voice {
                Voice::None => "none".to_owned(),
                Voice::Lost => "lost".to_owned(),
                Voice::Found { excess, .. } => format!("found {excess:.2?}"),
            }
        );
    }
}

fn grow(map: &mut Map, uploads: &[Upload], vetter: &mut Vetter, limits: &Limits, tally: &mut Tally) {
    let began = cpu_ms();
    for upload in uploads {
        let shares = shares(&upload.tiles);
        map.asking.set(Some(upload.pass.contributor));
        let vetted = vetter.vet(&shares, map, limits);
        map.asking.set(None);
        tally.uploads += 1;
        tally.tiles += shares.len();
        match vetted {
            Vetted::Agrees(offsets) => {
                tally.agree += 1;
                map.fold_moved(upload.pass, &upload.tiles, &offsets);
            }
            Vetted::New(offsets) => {
                tally.new += 1;
                map.fold_moved(upload.pass, &upload.tiles, &offsets);
            }
            Vetted::Quarantined { reason, offset } => {
                tally.quarantined += 1;
                if std::env::var("VERBOSE").is_ok() {
                    println!(
                        "  {} quarantined {reason:?} {offset:?}, error {:?}",
                        upload.pass.contributor, upload.error
                    );
                    show(vetter, map, upload, limits);
                }
            }
        }
    }
    tally.cpu_ms += cpu_ms() - began;
}

#[derive(Default, Debug)]
struct Tally {
    agree: usize,
    new: usize,
    quarantined: usize,
    tiles: usize,
    uploads: usize,
    cpu_ms: f64,
}

const SIZES: [usize; 3] = [1, 2, 5];

fn compare(seeds: &[u64]) {
    let mut errors: BTreeMap<(usize, usize), Vec<(f64, f64)>> = BTreeMap::new();
    let mut floors: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    let mut alarms = Alarms::default();
    let limits = Limits::default();
    let most = SIZES[SIZES.len() - 1];
    for seed in seeds {
        let town = town(*seed, most);
        let questions = questions(&town, 60);
        let poses = pose_errors(&town);
        println!("town {seed}: {} questions, {:.0} s", questions.len(), cpu_ms() / 1e3);
        let (mut a, mut b, mut exact) = (Map::default(), Map::default(), Map::default());
        let (mut vetter, mut tally) = (Vetter::default(), Tally::default());
        for n in 1..=most {
            let drive = &town.drives[n - 1];
            for upload in uploads(&town.grid, drive, n as u64, Wrong::Exact) {
                exact.fold(upload.pass, &upload.tiles);
            }
            let uploads = uploads(&town.grid, drive, n as u64, Wrong::No);
            for upload in &uploads {
                a.fold(upload.pass, &upload.tiles);
            }
            grow(&mut b, &uploads, &mut vetter, &limits, &mut tally);
            if SIZES.contains(&n) {
                let mut plain = [Vec::new(), Vec::new(), Vec::new()];
                let mut aligned = plain.clone();
                fixes(&a, &town, &questions, &mut plain);
                fixes(&b, &town, &questions, &mut aligned);
                let mut ideal = [Vec::new(), Vec::new(), Vec::new()];
                fixes(&exact, &town, &questions, &mut ideal);
                let ideal = ideal.into_iter().take(1);
                for (k, more) in plain.into_iter().take(1).chain(aligned).chain(ideal).enumerate() {
                    errors.entry((n, k)).or_default().extend(more);
                }
                floors.entry(n).or_default().extend(questions.iter().map(|(t, _)| floor(&poses[..n], t)));
            }
        }
        println!(
            "  agree {} new {} quarantined {}; {:.1} ms CPU an upload, {:.1} tiles an upload, {:.0} s so far",
            tally.agree,
            tally.new,
            tally.quarantined,
            tally.cpu_ms / tally.uploads as f64,
            tally.tiles as f64 / tally.uploads as f64,
            cpu_ms() / 1e3
        );
        b.prepared.borrow_mut().clear();
        let began = cpu_ms();
        let ids: Vec<TileId> = b.tiles.keys().copied().collect();
        for id in &ids {
            drop(b.weights(*id));
        }
        println!("  TileWeights {:.2} ms a tile, {} tiles", (cpu_ms() - began) / ids.len() as f64, ids.len());
        let began = cpu_ms();
        let all = uploads(&town.grid, &town.drives[0], 7, Wrong::No);
        let cut = cpu_ms();
        for upload in &all {
            let _ = vetter.vet(&shares(&upload.tiles), &b, &limits);
        }
        let vetted = cpu_ms();
        for upload in &all {
            let mut offsets = Offsets::default();
            offsets.push([0.0, 0.0], Offset { east_mm: 120, north_mm: 60, yaw_urad: 10 }, 1.0);
            let _ = moved(&shares(&upload.tiles), &offsets);
        }
        let n = all.len() as f64;
        println!(
            "  an upload, tiles prepared: placing scans {:.1} ms, vetting {:.1} ms, moving {:.1} ms",
            (cut - began) / n,
            (vetted - cut) / n,
            (cpu_ms() - vetted) / n
        );
        if std::env::var("ALARMS").is_ok() {
            alarms.ask(&town, &b, &mut vetter, &limits, most);
        }
    }
    for n in SIZES {
        for (k, name) in [
            "plain",
            "aligned, no datum",
            "aligned, datum of passes",
            "aligned, of uploads",
            "map of exact poses",
        ]
        .iter()
        .enumerate()
        {
            row(&format!("{n:2} {name:24}"), &errors[&(n, k)]);
        }
        let f = percentiles(floors[&n].iter().map(|f| f * 100.0).collect());
        println!("{n:2} floor                   : {:.1} / {:.1} / {:.1} cm", f[0], f[1], f[2]);
    }
    alarms.show();
}

/// How many honest and how many wrong uploads are quarantined.
#[derive(Default)]
struct Alarms {
    table: BTreeMap<(usize, String), [usize; 5]>,
    spread: BTreeMap<usize, Vec<Pose2>>,
}

impl Alarms {
    fn ask(&mut self, town: &Town, map: &Map, vetter: &mut Vetter, limits: &Limits, n: usize) {
        let deg = f64::to_radians;
        let wrongs = [
            Wrong::No,
            Wrong::Shift(0.5),
            Wrong::Shift(0.6),
            Wrong::Shift(0.75),
            Wrong::Shift(1.0),
            Wrong::Shift(2.0),
            Wrong::Shift(5.0),
            Wrong::Turn(deg(2.0)),
            Wrong::Turn(deg(3.0)),
            Wrong::Heading(deg(2.0)),
            Wrong::Elsewhere(30.0),
            Wrong::Elsewhere(150.0),
        ];
        for wrong in wrongs {
            for upload in uploads(&town.grid, &town.localized, 99, wrong) {
                let shares = shares(&upload.tiles);
                if wrong == Wrong::No {
                    for p in vetter.probe(&shares, map, limits) {
                        if let (Voice::Found { error, .. }, Some(at)) = (p.voice, p.placement)
                            && at.points > 1500
                        {
                            self.spread.entry(n).or_default().push(error);
                        }
                    }
                }
                let which = match vetter.vet(&shares, map, limits) {
                    Vetted::Agrees(_) => 0,
                    Vetted::New(_) => 1,
                    Vetted::Quarantined { reason: Reason::Shifted, .. } => 2,
                    Vetted::Quarantined { reason: Reason::Rotated, .. } => 3,
                    Vetted::Quarantined { reason: Reason::Disagrees, .. } => 4,
                };
                self.table.entry((n, format!("{wrong:.3?}"))).or_default()[which] += 1;
            }
        }
    }

    fn show(&self) {
        for ((n, wrong), counts) in &self.table {
            let all: usize = counts.iter().sum();
            let bad: usize = counts[2..].iter().sum();
            let share = 100.0 * bad as f64 / all as f64;
            println!(
                "{n:2} contributors, {wrong}: {share:.1} % of {all} quarantined; agree, new, shifted, rotated, disagrees {counts:?}"
            );
        }
        for (n, of) in &self.spread {
            let k = of.len() as f64;
            let rms = |f: fn(&Pose2) -> f64| (of.iter().map(|e| f(e).powi(2)).sum::<f64>() / k).sqrt();
            let far = percentiles(of.iter().map(|e| e.x_m.hypot(e.y_m)).collect());
            let turn = rms(|e| e.yaw_rad).to_degrees();
            println!(
                "{n}: {} parts, sd {:.3} {:.3} m {turn:.3} deg; shift {far:.3?}",
                of.len(),
                rms(|e| e.x_m),
                rms(|e| e.y_m)
            );
        }
    }
}

/// What parts measure, beside the truth.
fn dump(seed: u64) {
    let town = town(seed, 4);
    let mut map = Map::default();
    let limits = Limits::default();
    let (mut vetter, mut tally) = (Vetter::default(), Tally::default());
    for n in 0..3 {
        let uploads = uploads(&town.grid, &town.drives[n], n as u64, Wrong::No);
        grow(&mut map, &uploads, &mut vetter, &limits, &mut tally);
    }
    println!("{tally:?}");
    for wrong in [
        Wrong::No,
        Wrong::Shift(1.0),
        Wrong::Turn(2_f64.to_radians()),
        Wrong::Heading(2_f64.to_radians()),
        Wrong::Elsewhere(30.0),
        Wrong::Elsewhere(150.0),
    ] {
        println!("{wrong:?}");
        for upload in uploads(&town.grid, &town.drives[3], 9, wrong).iter().take(60) {
            let shares = shares(&upload.tiles);
            let verdict = vetter.vet(&shares, &map, &limits);
            let word = match verdict {
                Vetted::Agrees(_) => "agrees".to_owned(),
                Vetted::New(_) => "new".to_owned(),
                Vetted::Quarantined { reason, offset } => format!("{reason:?} {offset:?}"),
            };
            println!(
                "upload error {:.2} {:.2} {:.2}: {word}",
                upload.error.x_m,
                upload.error.y_m,
                upload.error.yaw_rad.to_degrees()
            );
            show(&mut vetter, &map, upload, &limits);
        }
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let seeds: Vec<u64> = words.iter().skip(1).filter_map(|w| w.parse().ok()).collect();
    match words.first().map(String::as_str) {
        Some("fixes") => compare(&seeds),
        _ => dump(seeds[0]),
    }
}
