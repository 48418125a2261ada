//! What stands along a drawn street: fronts, parked cars, posts, joints.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use echofix_core::pose::Pose2;
use rand_chacha::ChaCha8Rng;

use crate::city::{
    Frontage, Look, ParkingSlot, ReflectorKind, Street, Structure, build_fronts, build_furniture,
    parking_slots, street_frame,
};
use crate::plane::Point;
use crate::rng::{poisson, uniform};

/// Reflectors stand this far in front of their wall, so that it does not hide them, metres.
const PROUD_M: f64 = 0.03;
/// The street's right side and its left.
const SIDES: [f64; 2] = [-1.0, 1.0];
/// From the middle of a parked car to the kerb, metres.
const HALF_CAR_M: f64 = 1.15;

/// Buildings along a street.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fronts {
    /// None.
    Open,
    /// Facades as in towns, no two alike.
    Random,
    /// Windows of one size at one pitch, metres: each bay like the next.
    Periodic(f64),
    /// A tunnel: even walls with a joint every so many metres.
    Tunnel(f64),
}

/// Cars along a street.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Parking {
    /// None.
    Free,
    /// Slots as in towns, with gaps.
    Random,
    /// Rows without a gap, of one pitch on both sides, metres.
    Rows(f64),
}

/// What stands along a street.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreetStyle {
    /// From the centre line to the kerb, metres.
    pub kerb_m: f64,
    /// From the centre line to the fronts, metres.
    pub front_m: f64,
    /// Buildings.
    pub fronts: Fronts,
    /// Cars.
    pub parking: Parking,
    /// Pitch of posts along both kerbs, if there are any, metres.
    pub posts_m: Option<f64>,
    /// Lamps, signs and trees as in towns?
    pub furniture: bool,
    /// Things of any kind behind the kerb, mean count per 100 m and side.
    pub things_per_100_m: f64,
}

impl StreetStyle {
    /// Builds along a street; returns its parking slots.
    pub(super) fn build(
        &self,
        structure: &mut Structure,
        street: &Street,
        (seed, index): (u64, usize),
        rng: &mut ChaCha8Rng,
    ) -> Vec<ParkingSlot> {
        let frame = street_frame(street);
        let length_m = street.length_m();
        match self.fronts {
            Fronts::Open => (),
            Fronts::Random => self.random_fronts(structure, street, (seed, index)),
            Fronts::Periodic(pitch_m) => self.bays(structure, &frame, length_m, pitch_m),
            Fronts::Tunnel(joint_m) => self.tunnel(structure, &frame, length_m, joint_m),
        }
        if self.furniture {
            build_furniture(structure, street, seed, index);
        }
        if let Some(pitch_m) = self.posts_m {
            let post = Look { kind: ReflectorKind::Fence, probability: 0.35, rcs_dbsm: 1.0, edge_rad: 4.0 };
            let y = self.kerb_m + 0.3;
            let at = positions(length_m, pitch_m).flat_map(|x| SIDES.map(|sign| [x, sign * y]));
            structure.reflectors.extend(at.map(|at| post.at(&frame, at, 0.0)));
        }
        self.things(structure, &frame, length_m, rng);
        match self.parking {
            Parking::Free => Vec::new(),
            Parking::Random => parking_slots(street, seed, index),
            Parking::Rows(pitch_m) => self.rows(&frame, length_m, pitch_m),
        }
    }

    fn random_fronts(&self, structure: &mut Structure, street: &Street, (seed, index): (u64, usize)) {
        let frame = street_frame(street);
        let at = |x, y| frame.transform([x, y]);
        let (l, y) = (street.length_m(), self.front_m);
        let sides = [Frontage { a: at(0.0, y), b: at(l, y) }, Frontage { a: at(l, -y), b: at(0.0, -y) }];
        for (side, frontage) in sides.into_iter().enumerate() {
            build_fronts(structure, frontage, seed, 2 * index + side);
        }
    }

    /// Windows whose jambs are each seen from one oblique side.
    fn bays(&self, structure: &mut Structure, frame: &Pose2, length_m: f64, pitch_m: f64) {
        let jamb = Look { kind: ReflectorKind::Corner, probability: 0.3, rcs_dbsm: 5.0, edge_rad: 1.2 };
        for sign in SIDES {
            self.wall(structure, frame, length_m, sign);
            let (y, out) = (sign * (self.front_m - PROUD_M), -sign * FRAC_PI_2);
            for x in positions(length_m, pitch_m) {
                for side in [-1.0, 1.0] {
                    let facing = out - side * sign * FRAC_PI_4;
                    structure.reflectors.push(jamb.at(frame, [x + side * 0.8, y], facing));
                }
            }
        }
    }

    /// Walls whose every decimetre answers alike, and a strong line at every joint.
    fn tunnel(&self, structure: &mut Structure, frame: &Pose2, length_m: f64, joint_m: f64) {
        let rough = Look { kind: ReflectorKind::Wall, probability: 0.02, rcs_dbsm: -2.0, edge_rad: 1.3 };
        let joint = Look { kind: ReflectorKind::Corner, probability: 0.35, rcs_dbsm: 5.0, edge_rad: 1.3 };
        for sign in SIDES {
            self.wall(structure, frame, length_m, sign);
            let (y, out) = (sign * (self.front_m - PROUD_M), -sign * FRAC_PI_2);
            let mut row = |look: Look, spacing_m: f64| {
                let at = positions(length_m, spacing_m).map(|x| look.at(frame, [x, y], out));
                structure.reflectors.extend(at);
            };
            row(rough, 0.2);
            row(joint, joint_m);
        }
    }

    fn wall(&self, structure: &mut Structure, frame: &Pose2, length_m: f64, sign: f64) {
        structure.wall(frame, &[[0.0, sign * self.front_m], [length_m, sign * self.front_m]]);
    }

    /// Bushes, cabinets, signs: of any strength, anywhere from the kerb to the fronts, at most 20 m behind it.
    fn things(&self, structure: &mut Structure, frame: &Pose2, length_m: f64, rng: &mut ChaCha8Rng) {
        let far_m = (self.front_m - 0.2).min(self.kerb_m + 20.0);
        for sign in SIDES {
            for _ in 0..poisson(rng, 0.01 * self.things_per_100_m * length_m) {
                let look = Look {
                    kind: ReflectorKind::Pole,
                    probability: uniform(rng, (0.05, 0.3)),
                    rcs_dbsm: uniform(rng, (-8.0, 5.0)),
                    edge_rad: 4.0,
                };
                let at: Point = [uniform(rng, (0.0, length_m)), sign * uniform(rng, (self.kerb_m, far_m))];
                structure.reflectors.push(look.at(frame, at, 0.0));
            }
        }
    }

    fn rows(&self, frame: &Pose2, length_m: f64, period_m: f64) -> Vec<ParkingSlot> {
        let row = |sign: f64| {
            let yaw_rad = if sign > 0.0 { PI } else { 0.0 };
            let slot = move |x| ParkingSlot {
                pose: frame.compose(&Pose2::new(x, sign * (self.kerb_m - HALF_CAR_M), yaw_rad)),
                period_m,
            };
            positions(length_m, period_m).map(slot)
        };
        SIDES.into_iter().flat_map(row).collect()
    }
}

/// Positions along the street, so far apart.
fn positions(length_m: f64, spacing_m: f64) -> impl Iterator<Item = f64> {
    (0..(length_m / spacing_m) as usize).map(move |k| (k as f64 + 0.5) * spacing_m)
}
