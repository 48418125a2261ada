//! How well the poses are known that an upload was mapped from.

/// What a contributor declares of its poses: one sigma, in whole millimetres and microradians. 0 stands for nothing
/// declared, as in all data of before there were declarations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, PartialOrd, Ord)]
pub struct PoseSigma {
    position_mm: u16,
    yaw_urad: u32,
}

/// Error of poses that nothing is declared of: one sigma along each axis, millimetres.
const SILENT_MM: u16 = 80;
/// The same of their heading, microradians: 0.15 degrees, a decimetre-grade inertial navigation system's.
const SILENT_URAD: u32 = 2618;
/// A better declaration counts as this one, millimetres: timing and lever arms of a vehicle are hardly known better, and
/// it bounds how much one contributor may pull.
const BEST_MM: u16 = 30;
/// The same of the heading, microradians.
const BEST_URAD: u32 = 500;
/// A worse declaration counts as this one, millimetres and microradians.
const WORST: (u16, u32) = (5_000, 100_000);

impl PoseSigma {
    /// From metres and radians, rounded up and kept within 3 cm to 5 m and 0.5 to 100 mrad. What is 0, negative or
    /// not a number is not declared.
    #[must_use]
    pub fn declared(position_m: f64, yaw_rad: f64) -> Self {
        let whole = |value: f64, unit: f64, best: f64, worst: f64| {
            // A value that was sent in single precision is a little off.
            if value > 0.0 { (value * unit - 1e-3).ceil().clamp(best, worst) } else { 0.0 }
        };
        Self {
            position_mm: whole(position_m, 1e3, BEST_MM.into(), WORST.0.into()) as u16,
            yaw_urad: whole(yaw_rad, 1e6, BEST_URAD.into(), WORST.1.into()) as u32,
        }
    }

    /// The largest of both, column by column: of an upload in parts.
    #[must_use]
    pub fn larger(self, other: Self) -> Self {
        Self {
            position_mm: self.position_mm.max(other.position_mm),
            yaw_urad: self.yaw_urad.max(other.yaw_urad),
        }
    }

    /// True when nothing is declared.
    #[must_use]
    pub fn is_silent(self) -> bool {
        self == Self::default()
    }

    /// Error of the position along each axis, metres; 0.08 where nothing is declared.
    #[must_use]
    pub fn position_m(self) -> f64 {
        f64::from(self.millimetres()) * 1e-3
    }

    /// Error of the heading, radians; 0.15 degrees where nothing is declared.
    #[must_use]
    pub fn yaw_rad(self) -> f64 {
        f64::from(self.microradians()) * 1e-6
    }

    /// As stored: millimetres and microradians, 0 where nothing is declared.
    #[must_use]
    pub fn stored(self) -> (u16, u32) {
        (self.position_mm, self.yaw_urad)
    }

    /// From what was stored; `None` where it could not have been.
    #[must_use]
    pub fn from_stored(position_mm: u16, yaw_urad: u32) -> Option<Self> {
        let sound = (position_mm == 0 || (BEST_MM..=WORST.0).contains(&position_mm))
            && (yaw_urad == 0 || (BEST_URAD..=WORST.1).contains(&yaw_urad));
        sound.then_some(Self { position_mm, yaw_urad })
    }

    fn millimetres(self) -> u16 {
        if self.position_mm == 0 { SILENT_MM } else { self.position_mm }
    }

    fn microradians(self) -> u32 {
        if self.yaw_urad == 0 { SILENT_URAD } else { self.yaw_urad }
    }

    /// What a pass counts for: the inverse variance of its position, in [`super::INFORMATION_STEPS`] to one per square
    /// metre, and of its heading, per square radian. Whole numbers.
    pub(super) fn information(self) -> (u64, u64) {
        let (mm, urad) = (u64::from(self.millimetres()), u64::from(self.microradians()));
        (super::INFORMATION_STEPS * 1_000_000 / (mm * mm), 1_000_000_000_000 / (urad * urad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Catches: a declaration that its own stored form refuses, and one that is made better by being stored.
        #[test]
        fn what_is_declared_can_be_stored(position_m in -1.0..20.0_f64, yaw_rad in -0.1..1.0_f64) {
            let sigma = PoseSigma::declared(position_m, yaw_rad);
            let (mm, urad) = sigma.stored();
            prop_assert_eq!(PoseSigma::from_stored(mm, urad), Some(sigma));
            prop_assert!(position_m <= 0.0 || sigma.position_m() >= position_m.min(5.0) - 1e-5);
            prop_assert!(sigma.information().0 > 0 && sigma.information().1 > 0);
        }
    }

    #[test]
    fn nothing_declared_is_what_the_map_had_before() {
        for nothing in [0.0, -1.0, f64::NAN] {
            assert!(PoseSigma::declared(nothing, nothing).is_silent());
        }
        assert!((PoseSigma::default().position_m() - 0.08).abs() < 1e-12);
        assert_eq!(PoseSigma::default().information(), PoseSigma::declared(0.08, 0.002_618).information());
        assert_eq!(PoseSigma::declared(f64::from(0.25_f32), 0.007).stored(), (250, 7000));
        assert_eq!(PoseSigma::from_stored(3, 0), None);
    }
}
