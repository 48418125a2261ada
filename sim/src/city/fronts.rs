//! Building fronts: facades with bays and doors, alleys, fenced lots.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use echofix_core::pose::Pose2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::streets::Frontage;
use super::structure::{Look, ReflectorKind, Structure};
use crate::plane::{direction, distance};
use crate::rng::{Purpose, normal, stream, uniform};

/// Yaw of the street as seen from a front, in the front's frame (x along, y into the block).
const OUT: f64 = -FRAC_PI_2;
/// Reflectors stand this far in front of their wall, so that it does not hide them, metres.
const PROUD_M: f64 = 0.03;
/// How deep into the block walls are modelled, metres.
const DEPTH_M: f64 = 12.0;
/// No gap nearer to a frontage's end than this: there the neighbouring frontage's buildings stand.
const CORNER_LOT_M: f64 = 17.0;

/// Builds the fronts of one frontage.
pub(crate) fn build(structure: &mut Structure, frontage: Frontage, seed: u64, index: usize) {
    let along = direction(frontage.a, frontage.b);
    let frame = Pose2::new(frontage.a[0], frontage.a[1], along[1].atan2(along[0]));
    let rng = stream(seed, Purpose::Fronts, index as u64, 0);
    let length_m = distance(frontage.a, frontage.b);
    Builder { structure, frame, rng }.fill(length_m);
}

/// An open lot behind a fence in the frame of a line of fronts (x along, y into the block).
pub(super) fn fenced_lot(
    structure: &mut Structure,
    frame: Pose2,
    along: (f64, f64),
    seed: u64,
    index: usize,
) {
    let rng = stream(seed, Purpose::Fronts, index as u64, 1);
    Builder { structure, frame, rng }.fenced(along);
}

struct Builder<'a> {
    structure: &'a mut Structure,
    frame: Pose2,
    rng: ChaCha8Rng,
}

impl Builder<'_> {
    fn fill(&mut self, length_m: f64) {
        let mut from = 0.0;
        while from < length_m {
            let mut to = from + uniform(&mut self.rng, (9.0, 28.0));
            if length_m - to < 9.0 {
                to = length_m;
            }
            let at_corner = from == 0.0 || to >= length_m;
            let setback =
                if at_corner || self.rng.random_bool(0.5) { 0.0 } else { uniform(&mut self.rng, (0.3, 2.0)) };
            self.facade((from, to), setback, (from > 0.0, to < length_m));
            from = to;
            if from > CORNER_LOT_M && length_m - from > CORNER_LOT_M + 20.0 {
                from = match self.rng.random_range(0..10) {
                    0..3 => self.alley(from),
                    3..5 => self.lot(from),
                    _ => from,
                };
            }
        }
    }

    /// A building with side walls where it has a neighbour; at a corner the other front closes it.
    fn facade(&mut self, (from, to): (f64, f64), setback: f64, sides: (bool, bool)) {
        let y = setback;
        let door = uniform(&mut self.rng, (from + 1.5, to - 4.0));
        let (width, depth) = (uniform(&mut self.rng, (1.2, 2.5)), uniform(&mut self.rng, (0.4, 1.6)));
        let frame = self.frame;
        let mut outline = vec![
            [from, y],
            [door, y],
            [door, y + depth],
            [door + width, y + depth],
            [door + width, y],
            [to, y],
        ];
        if sides.0 {
            outline.insert(0, [from, y + DEPTH_M]);
        }
        if sides.1 {
            outline.push([to, y + DEPTH_M]);
        }
        self.structure.wall(&frame, &outline);
        let strength = uniform(&mut self.rng, (0.6, 1.4));
        self.corner([from + 0.1, y - PROUD_M], OUT - FRAC_PI_4, 0.22 * strength);
        self.corner([to - 0.1, y - PROUD_M], OUT + FRAC_PI_4, 0.22 * strength);
        self.corner([door + 0.05, y + depth - PROUD_M], OUT + FRAC_PI_4, 0.3);
        self.corner([door + width - 0.05, y + depth - PROUD_M], OUT - FRAC_PI_4, 0.3);
        self.bays(from, to, y, strength);
        self.rough(from, to, y, strength);
    }

    /// Window jambs at a regular spacing, each seen from one oblique side.
    fn bays(&mut self, from: f64, to: f64, y: f64, strength: f64) {
        let period = uniform(&mut self.rng, (2.8, 5.2));
        let half_window = uniform(&mut self.rng, (0.5, 1.1));
        let mut bay = from + uniform(&mut self.rng, (1.2, 1.2 + period));
        while bay + half_window < to - 0.3 {
            self.corner([bay - half_window, y - PROUD_M], OUT + FRAC_PI_4, 0.15 * strength);
            self.corner([bay + half_window, y - PROUD_M], OUT - FRAC_PI_4, 0.15 * strength);
            bay += period;
        }
    }

    fn rough(&mut self, from: f64, to: f64, y: f64, strength: f64) {
        let per_m = uniform(&mut self.rng, (4.0, 8.0));
        for _ in 0..(per_m * (to - from)) as usize {
            let look = Look {
                kind: ReflectorKind::Wall,
                probability: strength * uniform(&mut self.rng, (0.03, 0.2)),
                rcs_dbsm: -3.0 + normal(&mut self.rng, 4.0),
                edge_rad: uniform(&mut self.rng, (0.5, 1.1)),
            };
            let position = [uniform(&mut self.rng, (from, to)), y - PROUD_M];
            let facing = OUT + uniform(&mut self.rng, (-1.2, 1.2));
            self.structure.reflectors.push(look.at(&self.frame, position, facing));
        }
    }

    fn corner(&mut self, position: [f64; 2], facing: f64, probability: f64) {
        let look = Look {
            kind: ReflectorKind::Corner,
            probability,
            rcs_dbsm: 5.0 + normal(&mut self.rng, 4.0),
            edge_rad: 1.2,
        };
        self.structure.reflectors.push(look.at(&self.frame, position, facing));
    }

    /// A passage between two buildings; returns where the next one starts.
    fn alley(&mut self, from: f64) -> f64 {
        let to = from + uniform(&mut self.rng, (3.0, 6.0));
        self.structure.wall(&self.frame, &[[from, DEPTH_M], [to, DEPTH_M]]);
        let bin = [uniform(&mut self.rng, (from + 0.8, to - 0.8)), uniform(&mut self.rng, (1.0, 6.0))];
        self.corner(bin, OUT, 0.35);
        self.corner([from + 0.1, DEPTH_M - 0.1], OUT + 0.3, 0.3);
        self.corner([to - 0.1, DEPTH_M - 0.1], OUT - 0.3, 0.3);
        to
    }

    /// An open lot behind a fence; returns where the next building starts.
    fn lot(&mut self, from: f64) -> f64 {
        let to = from + uniform(&mut self.rng, (10.0, 20.0));
        self.fenced((from, to));
        to
    }

    fn fenced(&mut self, (from, to): (f64, f64)) {
        let spacing = uniform(&mut self.rng, (2.0, 3.0));
        let mut post = from + 0.5;
        while post < to {
            let look = Look { kind: ReflectorKind::Fence, probability: 0.15, rcs_dbsm: -4.0, edge_rad: 4.0 };
            self.structure.reflectors.push(look.at(&self.frame, [post, 0.3], OUT));
            post += spacing;
        }
        self.structure.wall(&self.frame, &[[from, DEPTH_M], [to, DEPTH_M]]);
        self.rough(from, to, DEPTH_M, 1.0);
    }
}
