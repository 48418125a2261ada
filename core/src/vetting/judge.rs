//! What the parts of an upload say together.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::part::{self, Part, Placement, Prober, Probing};
use super::{MapSide, Offsets, Share};
use crate::datum::{Offset, mean_offset};
use crate::geo::TileId;
use crate::pose::Pose2;

/// When an upload agrees with the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Shift from where the crowd says the truth is, metres, beyond which an upload is wrong; the mean of few
    /// errs itself, which allows for `sqrt(1 + 1 / passes)` times as much.
    pub shift_m: f64,
    /// The same for the turn, radians.
    pub yaw_rad: f64,
    /// One-sigma error of an honest upload along each axis, metres: what nothing holds is drawn to the
    /// crowd's mean by it.
    pub sigma_m: f64,
    /// The same for its heading, radians.
    pub sigma_yaw_rad: f64,
    /// Share of a part near which the map must have something, for the part to be placed by it.
    pub min_coverage: f64,
    /// The same, for the map to tell that the part belongs elsewhere or nowhere.
    pub known_coverage: f64,
    /// Score relative to a random shift's, below which a part is found nowhere.
    pub min_contrast: f64,
    /// How parts are made and placed.
    pub probing: Probing,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            shift_m: 0.45,
            yaw_rad: 1_f64.to_radians(),
            sigma_m: 0.12,
            sigma_yaw_rad: 0.2_f64.to_radians(),
            min_coverage: 0.3,
            known_coverage: 0.9,
            min_contrast: 1.35,
            probing: Probing::default(),
        }
    }
}

/// Why an upload is kept out of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// It lies beside the map.
    Shifted,
    /// It is turned against the map.
    Rotated,
    /// It shows something else than the map.
    Disagrees,
}

/// What vetting says of an upload.
#[derive(Debug, Clone, PartialEq)]
pub enum Vetted {
    /// It agrees; moved by these offsets it lies on the map.
    Agrees(Offsets),
    /// The map has nothing there to hold it against. These offsets are what its neighbourhood was moved by.
    New(Offsets),
    /// It is kept out of the map.
    Quarantined {
        /// Why.
        reason: Reason,
        /// What would move it to where the crowd says the truth is, where that could be measured.
        offset: Option<Offset>,
    },
}

/// One thread's engine and buffers.
#[derive(Default)]
pub struct Vetter {
    prober: Prober,
}

/// A part of an upload, and what it says.
#[derive(Debug, Clone)]
pub struct Probed {
    /// The part.
    pub part: Part,
    /// What the crowd says that the map errs by, at the part's middle.
    pub expected: Pose2,
    /// Where the part lies, if the map has anything there.
    pub placement: Option<Placement>,
    /// What it says.
    pub voice: Voice,
}

/// What a part says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Voice {
    /// Nothing: the map knows too little there.
    None,
    /// It is found nowhere.
    Lost,
    /// It lies here.
    Found {
        /// Shift and turn beyond what was expected, drawn to zero where nothing holds the part.
        error: Pose2,
        /// The same in limits: shift and turn.
        excess: [f64; 2],
    },
}

impl Vetter {
    /// Holds an upload, its cells in one zone, against the map.
    pub fn vet(&mut self, shares: &[Share], map: &dyn MapSide, limits: &Limits) -> Vetted {
        together(&self.probe(shares, map, limits))
    }

    /// The parts of an upload and what each says: what [`Vetter::vet`] rests on.
    pub fn probe(&mut self, shares: &[Share], map: &dyn MapSide, limits: &Limits) -> Vec<Probed> {
        let mut tiles = BTreeMap::new();
        let mut probed = Vec::new();
        for part in part::parts(shares, limits.probing.extent_m) {
            let id = TileId::of(part.zone, part.middle);
            let expected = mean_offset(part.zone, part.middle, |id| map.datum(id));
            let young = (1.0 + 1.0 / f64::from(map.datum(id).passes.max(1))).sqrt();
            let placement = self.prober.place(&part, &expected, map, &mut tiles, &limits.probing);
            let voice = placement.map_or(Voice::None, |at| voice(&at, young, limits));
            probed.push(Probed { part, expected, placement, voice });
        }
        probed
    }
}

fn voice(at: &Placement, young: f64, limits: &Limits) -> Voice {
    let sigma = [limits.sigma_m, limits.sigma_m, limits.sigma_yaw_rad].map(|s| s * young);
    let error = drawn(&at.error, &at.covariance, sigma);
    let excess = [error.x_m.hypot(error.y_m) / limits.shift_m, error.yaw_rad.abs() / limits.yaw_rad];
    let excess = excess.map(|e| e / young);
    let held = at.covariance.iter().all(|v| v.is_finite());
    let fits = held && at.contrast >= limits.min_contrast;
    let found = Voice::Found { error, excess };
    let known = at.coverage >= limits.known_coverage;
    if excess.iter().all(|e| *e <= 1.0) {
        return match (fits, known) {
            (true, _) if at.coverage >= limits.min_coverage => found,
            (false, true) if at.contrast < limits.min_contrast => Voice::Lost,
            _ => Voice::None,
        };
    }
    // The expected place was given up for another one: that tells something only where the map is known.
    let clear = fits && !at.at_edge && at.margin >= limits.probing.min_margin;
    match (known, clear) {
        (false, _) => Voice::None,
        (true, true) => found,
        (true, false) => Voice::Lost,
    }
}

/// A measurement, drawn to zero as far as its errors exceed those that are expected.
fn drawn(measured: &Pose2, covariance: &Matrix3<f64>, sigma: [f64; 3]) -> Pose2 {
    let expected = Matrix3::from_diagonal(&Vector3::from(sigma.map(|s| s * s)));
    let gain = (expected + covariance).try_inverse().map(|inverse| expected * inverse);
    let Some(gain) = gain.filter(|g| g.iter().all(|v| v.is_finite())) else { return Pose2::IDENTITY };
    let [x, y, yaw]: [f64; 3] = (gain * Vector3::new(measured.x_m, measured.y_m, measured.yaw_rad)).into();
    Pose2::new(x, y, yaw)
}

/// What the parts say, each counting by its blocks.
fn together(probed: &[Probed]) -> Vetted {
    let (mut agree, mut lost, mut wrong) = (0, 0, [0, 0]);
    let mut errors = Vec::new();
    for Probed { placement, voice, .. } in probed {
        let Some(Placement { points, error, .. }) = placement else { continue };
        match voice {
            Voice::None => {}
            Voice::Lost => lost += points,
            Voice::Found { excess: [shift, turn], .. } if *shift <= 1.0 && *turn <= 1.0 => agree += points,
            Voice::Found { excess: [_, turn], .. } => {
                wrong[usize::from(*turn > 1.0)] += points;
                errors.push((*error, *points));
            }
        }
    }
    let [shifted, turned] = wrong;
    if agree > 0 && agree >= lost + shifted + turned {
        return Vetted::Agrees(offsets(probed));
    }
    if lost + shifted + turned == 0 {
        return Vetted::New(offsets(probed));
    }
    if lost > shifted + turned {
        return Vetted::Quarantined { reason: Reason::Disagrees, offset: None };
    }
    let reason = if turned >= shifted { Reason::Rotated } else { Reason::Shifted };
    Vetted::Quarantined { reason, offset: heaviest(&errors).map(|error| Offset::of(&error)) }
}

/// What moves the parts that agree onto the map; if none does, what is expected of them.
fn offsets(probed: &[Probed]) -> Offsets {
    let mut offsets = Offsets::default();
    for Probed { part, expected, placement, voice } in probed {
        let (Voice::Found { error, excess }, Some(at)) = (voice, placement) else { continue };
        if excess.iter().all(|e| *e <= 1.0) {
            let onto_map = sum(expected, error);
            let spread = at.covariance[(0, 0)] + at.covariance[(1, 1)];
            offsets.push(part.middle, Offset::of(&onto_map), 1.0 / (spread + FLOOR_M * FLOOR_M));
        }
    }
    if offsets.is_empty() {
        for Probed { part, expected, .. } in probed {
            offsets.push(part.middle, Offset::of(expected), 1.0);
        }
    }
    offsets
}

/// What a part's place is uncertain by, however well it is held, metres.
const FLOOR_M: f64 = 0.05;

fn sum(a: &Pose2, b: &Pose2) -> Pose2 {
    Pose2::new(a.x_m + b.x_m, a.y_m + b.y_m, a.yaw_rad + b.yaw_rad)
}

/// The error of the part with most blocks.
fn heaviest(errors: &[(Pose2, usize)]) -> Option<Pose2> {
    errors.iter().max_by_key(|(_, points)| *points).map(|(error, _)| *error)
}

#[cfg(test)]
mod tests;
