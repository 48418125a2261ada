//! Rows of parking slots, the same every day, and the cars that stand in them on one day.

use std::f64::consts::PI;

use echofix_core::pose::Pose2;
use rand::RngExt;

use super::CityParams;
use super::furniture::{CLEAR_M, street_frame};
use super::streets::Street;
use super::vehicle::Car;
use crate::rng::{Purpose, normal, stream, uniform};

/// A slot to park in along the kerb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParkingSlot {
    /// Its middle, city metres, and the direction cars are parked in.
    pub pose: Pose2,
    /// Distance from slot to slot, metres.
    pub period_m: f64,
}

/// The slots on both sides of one street.
pub(crate) fn slots(street: &Street, seed: u64, index: usize) -> Vec<ParkingSlot> {
    let frame = street_frame(street);
    let mut slots = Vec::new();
    for (side, sign, yaw_rad) in [(0, -1.0, 0.0), (1, 1.0, PI)] {
        let mut rng = stream(seed, Purpose::Slots, index as u64, side);
        let period_m = uniform(&mut rng, (4.7, 6.0));
        if rng.random_bool(0.12) {
            continue;
        }
        let mut x = CLEAR_M + 3.0 + uniform(&mut rng, (0.0, period_m));
        while x + 0.5 * period_m < street.length_m() - CLEAR_M - 3.0 {
            // Driveways and hydrants interrupt the row.
            if !rng.random_bool(0.07) {
                let pose = frame.compose(&Pose2::new(x, sign * (street.kerb_m - 1.15), yaw_rad));
                slots.push(ParkingSlot { pose, period_m });
            }
            x += period_m;
        }
    }
    slots
}

/// The cars parked on one day, where they may. Each slot is drawn on its own.
pub(super) fn parked(
    slots: &[ParkingSlot],
    params: &CityParams,
    day: u32,
    may_park: impl Fn(&ParkingSlot) -> bool,
) -> Vec<Car> {
    let car = |(index, slot): (usize, &ParkingSlot)| {
        let mut rng = stream(params.seed, Purpose::Parked, u64::from(day), index as u64);
        let taken = rng.random_bool(params.parking_occupancy);
        let length_m = uniform(&mut rng, (3.8, slot.period_m.min(5.3) - 0.4));
        let slack_m = 0.5 * (slot.period_m - length_m);
        let offset = Pose2::new(
            normal(&mut rng, 0.4).clamp(-slack_m, slack_m),
            normal(&mut rng, 0.1).clamp(-0.15, 0.25),
            normal(&mut rng, 0.02),
        );
        let width_m = uniform(&mut rng, (1.7, 1.95));
        (taken && may_park(slot)).then(|| Car { pose: slot.pose.compose(&offset), length_m, width_m })
    };
    slots.iter().enumerate().filter_map(car).collect()
}
