//! What stands between the kerb and the fronts: lamps, signs, trees, traffic lights, kerb clutter.

use echofix_core::pose::Pose2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::streets::Street;
use super::structure::{Look, ReflectorKind, Structure};
use crate::plane::{Point, direction};
use crate::rng::{Purpose, normal, poisson, stream, uniform};

/// From an intersection's centre to where kerbside things begin, metres.
pub(super) const CLEAR_M: f64 = 12.0;
/// Edge of a reflector that is seen from all sides.
const ALL_ROUND: f64 = 4.0;

/// The frame of a street: x along it from its first node, y to the left.
pub(crate) fn street_frame(street: &Street) -> Pose2 {
    let along = direction(street.a, street.b);
    Pose2::new(street.a[0], street.a[1], along[1].atan2(along[0]))
}

/// Furnishes both sides of one street.
pub(crate) fn build(structure: &mut Structure, street: &Street, seed: u64, index: usize) {
    for (side, sign) in [(0, -1.0), (1, 1.0)] {
        let mut rng = stream(seed, Purpose::Furniture, index as u64, side);
        let look = [lamps, signs, trees, kerb].map(|row| row(&mut rng, street));
        let frame = street_frame(street);
        for (look, [x, y]) in look.into_iter().flatten() {
            structure.reflectors.push(look.at(&frame, [x, sign * y], 0.0));
        }
    }
}

type ReflectorRow = Vec<(Look, Point)>;

/// Positions along the street from one clear end to the other, about `spacing_m` apart.
fn positions(rng: &mut ChaCha8Rng, street: &Street, spacing_m: f64, jitter_m: f64) -> Vec<f64> {
    let end = street.length_m() - CLEAR_M;
    let mut x = CLEAR_M + uniform(rng, (0.0, spacing_m));
    let mut all = Vec::new();
    while x < end {
        all.push(x + uniform(rng, (-jitter_m, jitter_m)));
        x += spacing_m;
    }
    all
}

fn pole(probability: f64, rcs_dbsm: f64) -> Look {
    Look { kind: ReflectorKind::Pole, probability, rcs_dbsm, edge_rad: ALL_ROUND }
}

/// Lamps along the street and a traffic light at either end.
fn lamps(rng: &mut ChaCha8Rng, street: &Street) -> ReflectorRow {
    let spacing_m = uniform(rng, (20.0, 32.0));
    let mut at = positions(rng, street, spacing_m, 2.0);
    at.extend([CLEAR_M - 1.0, street.length_m() - CLEAR_M + 1.0]);
    at.into_iter().map(|x| (pole(0.3, 3.0 + normal(rng, 2.0)), [x, street.kerb_m + 0.7])).collect()
}

/// Parking meters or signs at a regular spacing, on some streets.
fn signs(rng: &mut ChaCha8Rng, street: &Street) -> ReflectorRow {
    if rng.random_bool(0.4) {
        return ReflectorRow::new();
    }
    let spacing_m = uniform(rng, (8.0, 14.0));
    let at = positions(rng, street, spacing_m, 0.1);
    at.into_iter().map(|x| (pole(0.15, -3.0 + normal(rng, 2.0)), [x, street.kerb_m + 0.4])).collect()
}

fn trees(rng: &mut ChaCha8Rng, street: &Street) -> ReflectorRow {
    if rng.random_bool(0.5) {
        return ReflectorRow::new();
    }
    let spacing_m = uniform(rng, (7.0, 13.0));
    let mut row = ReflectorRow::new();
    for x in positions(rng, street, spacing_m, 0.8) {
        let radius_m = uniform(rng, (0.1, 0.3));
        let look = Look { kind: ReflectorKind::Tree, probability: 0.1, rcs_dbsm: -3.0, edge_rad: ALL_ROUND };
        let y = street.kerb_m + 1.1;
        row.extend([[x - radius_m, y], [x + radius_m, y], [x, y - radius_m]].map(|at| (look, at)));
    }
    row
}

fn kerb(rng: &mut ChaCha8Rng, street: &Street) -> ReflectorRow {
    let (low, high) = (CLEAR_M, street.length_m() - CLEAR_M);
    let count = poisson(rng, 0.5 * (high - low));
    let mut thing = || {
        let look = Look {
            kind: ReflectorKind::Kerb,
            probability: uniform(rng, (0.03, 0.15)),
            rcs_dbsm: -8.0 + normal(rng, 4.0),
            edge_rad: ALL_ROUND,
        };
        (look, [uniform(rng, (low, high)), street.kerb_m + uniform(rng, (-0.1, 1.6))])
    };
    (0..count).map(|_| thing()).collect()
}
