//! All questions of a world.

use echofix_core::align::Search;
use echofix_core::batch::Batch;
use echofix_core::gate::Gate;
use echofix_core::pose::Pose2;
use echofix_sim::Family;

use super::answer::Answerer;
use super::batch::{BatchForm, organised};
use super::case::{Case, Place};
use super::record::{Question, TrustRecord};
use super::world::{AskingDrive, TrustWorld, is_beyond};
use crate::evaluate::method::RISK;

/// Seconds after the first scan before which nothing is asked: the longest batch.
const WARM_UP_US: i64 = 8_000_000;
/// Time between questions at least, microseconds.
const APART_US: i64 = 2_000_000;
/// Least time of driving before a question, microseconds.
const DRIVEN_US: i64 = 1_000_000;
/// How far before the end of the map, metres, and how far behind it questions are asked about it.
const AROUND_END_M: (f64, f64) = (30.0, 90.0);

/// Asks a world of a family in all these ways.
///
/// # Errors
/// When the world cannot be made.
pub fn ask(family: Family, seed: u64, cases: &[Case], quick: bool) -> anyhow::Result<Vec<TrustRecord>> {
    let mut world = TrustWorld::new(&family.world(seed)?)?;
    let most = if quick { 6 } else { 20 };
    let times = Times::of(&world, most);
    let answerer = Answerer::new(Search::default(), RISK);
    let mut asker = Asker { answerer, rows: Vec::new(), family, seed };
    // Cases of one form share their batches.
    let mut forms: Vec<(Place, BatchForm)> = Vec::new();
    for case in cases {
        if !forms.contains(&(case.place, case.form)) {
            forms.push((case.place, case.form));
        }
    }
    for (place, form) in forms {
        let cases: Vec<_> = cases.iter().filter(|case| (case.place, case.form) == (place, form)).collect();
        asker.ask_all(&mut world, &times, (place, form), &cases)?;
    }
    Ok(asker.rows)
}

/// When to ask, by the place.
struct Times {
    mapped: Vec<i64>,
    ends: Vec<i64>,
    stranger: Vec<i64>,
}

impl Times {
    fn of(world: &TrustWorld, most: usize) -> Self {
        let mapped = askable(&world.asking);
        let stranger = askable(&world.stranger);
        let ends = mapped.iter().copied().filter(|time_us| {
            world.asking.truth.at(*time_us).is_some_and(|pose| {
                let ahead = world.end.between(&pose).x_m;
                let before = world.end.compose(&Pose2::new(-AROUND_END_M.0, 0.0, 0.0));
                ahead < AROUND_END_M.1 && is_beyond(&before, &pose)
            })
        });
        let ends = ends.collect();
        let [mapped, ends, stranger] = [mapped, ends, stranger].map(|times| thinned(times, most));
        Self { mapped, ends, stranger }
    }

    fn at(&self, place: Place) -> &[i64] {
        match place {
            Place::Mapped => &self.mapped,
            Place::MapEnds => &self.ends,
            Place::Unmapped => &self.stranger,
        }
    }
}

/// Times of scans while driving, some seconds apart.
fn askable(asking: &AskingDrive) -> Vec<i64> {
    let drive = &asking.drive;
    let Some(first) = drive.scans.first() else { return Vec::new() };
    let least_mps = Gate::default().min_speed_mps;
    let (mut next_us, mut rested_us) = (first.time_us + WARM_UP_US, first.time_us);
    let mut times = Vec::new();
    for scan in &drive.scans {
        if drive.odometry.velocity_at(scan.time_us).map_or(0.0, |v| v.speed_mps()) <= least_mps {
            rested_us = scan.time_us;
        }
        let driven = scan.time_us - rested_us >= DRIVEN_US;
        if scan.time_us >= next_us && driven && asking.truth.at(scan.time_us + DRIVEN_US).is_some() {
            times.push(scan.time_us);
            next_us = scan.time_us + APART_US;
        }
    }
    times
}

fn thinned(times: Vec<i64>, most: usize) -> Vec<i64> {
    let count = times.len();
    if count <= most { times } else { (0..most).map(|k| times[k * count / most]).collect() }
}

/// One thread's questions.
struct Asker {
    answerer: Answerer,
    rows: Vec<TrustRecord>,
    family: Family,
    seed: u64,
}

/// A number for each of some indices, in which all bits depend on all of them (splitmix64).
fn mixed(words: &[u64]) -> u64 {
    words.iter().fold(0x9E37_79B9_7F4A_7C15, |hash, word| {
        let mut z = (hash ^ word).wrapping_add(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    })
}

impl Asker {
    fn ask_all(
        &mut self,
        world: &mut TrustWorld,
        times: &Times,
        (place, form): (Place, BatchForm),
        cases: &[&Case],
    ) -> anyhow::Result<()> {
        for (number, time_us) in times.at(place).iter().enumerate() {
            let asking = if place == Place::Unmapped { &world.stranger } else { &world.asking };
            let seed = mixed(&[self.family.number(), self.seed, number as u64]);
            let Some((batch, end_us)) = organised(&asking.drive, *time_us, form, seed)? else { continue };
            // Whoever is in an unmapped street is believed where the vehicle of this world is.
            let truth = (place != Place::Unmapped).then(|| asking.truth.at(end_us)).flatten();
            let believed = match place {
                Place::Unmapped => {
                    let times = times.at(Place::Mapped);
                    times.get(number % times.len().max(1)).and_then(|time_us| world.asking.truth.at(*time_us))
                }
                _ => truth,
            };
            let Some(believed) = believed else { continue };
            for case in cases {
                for prior in 0..case.priors {
                    let seed = mixed(&[seed, prior as u64, case.k.to_bits()]);
                    let asked = Asked { number, time_us: end_us, prior, seed, truth, believed };
                    self.ask_one(world, case, &batch, &asked);
                }
            }
        }
        Ok(())
    }

    fn ask_one(&mut self, world: &mut TrustWorld, case: &Case, batch: &Batch, asked: &Asked) {
        let Some(prior) = case.lie.drawn(&asked.believed, &world.known, world.scale, asked.seed) else {
            return;
        };
        let question = Question {
            family: self.family.word(),
            seed: self.seed,
            case,
            batch: asked.number,
            time_us: asked.time_us,
            prior_number: asked.prior,
            points: batch.points.len(),
            speed_mps: batch.speed_mps,
            prior,
            truth: asked.truth,
        };
        let map = if case.place == Place::MapEnds { &mut world.ending } else { &mut world.map };
        self.rows.push(self.answerer.answer(&question, batch, &world.grid, |square| map.weights(square)));
    }
}

/// When and from where is asked.
struct Asked {
    number: usize,
    time_us: i64,
    prior: usize,
    seed: u64,
    truth: Option<Pose2>,
    believed: Pose2,
}
