//! What a vehicle says of its own data: what it left out, and which conventions it suspects.

use echofix_core::convention::{Convention, Finding};
use echofix_proto::v1;

/// Conventions that are read of one message, at most.
const MAX_SUSPECTED: usize = 16;

/// What a vehicle says of its own data. Nothing checks it: it may keep the vehicle's data out, and nothing else.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Told {
    /// What its gates left out.
    pub dropped: v1::DroppedDetections,
    suspects: Vec<Convention>,
    /// Whether it has looked for them.
    inspected: bool,
}

impl Told {
    /// What a header or a batch says.
    #[must_use]
    pub fn of(dropped: Option<v1::DroppedDetections>, suspected: &[i32]) -> Self {
        let suspected = suspected.iter().take(MAX_SUSPECTED);
        let mut suspects: Vec<_> =
            suspected.filter_map(|code| convention(v1::Convention::try_from(*code).ok()?)).collect();
        suspects.sort_unstable();
        suspects.dedup();
        Self { dropped: dropped.unwrap_or_default(), suspects, inspected: false }
    }

    /// The same of a vehicle that says whether it has looked for other conventions.
    #[must_use]
    pub fn inspected(self, inspected: bool) -> Self {
        Self { inspected, ..self }
    }

    /// The finding for which an upload is refused: its movers outnumber what is left, and nobody has looked why, or another
    /// convention would explain them. What was looked at and is not explained is dense traffic.
    #[must_use]
    pub fn refused(&self, standing: u64) -> Option<Finding> {
        self.mostly_moving(standing).filter(|finding| !self.inspected || !finding.suspects().is_empty())
    }

    /// The finding that its movers outnumber what is left.
    #[must_use]
    pub fn mostly_moving(&self, standing: u64) -> Option<Finding> {
        (self.dropped.moving > standing).then(|| self.moving(standing))
    }

    /// The finding that a vehicle suspects its own data of another convention, where less was left out: of mirrored
    /// azimuths many returns stand still by chance.
    #[must_use]
    pub fn suspicion(&self, standing: u64) -> Option<Finding> {
        (!self.suspects.is_empty()).then(|| self.moving(standing))
    }

    fn moving(&self, standing: u64) -> Finding {
        let (moving, suspects) = (self.dropped.moving, self.suspects.clone());
        Finding::Moving { moving, of: moving.saturating_add(standing), sensor: None, suspects }
    }
}

fn convention(named: v1::Convention) -> Option<Convention> {
    Some(match named {
        v1::Convention::Unspecified => return None,
        v1::Convention::RadialSpeedTowards => Convention::RadialSpeedTowards,
        v1::Convention::RadialSpeedCompensated => Convention::RadialSpeedCompensated,
        v1::Convention::RadialSpeedKmh => Convention::RadialSpeedKmh,
        v1::Convention::AzimuthClockwise => Convention::AzimuthClockwise,
        v1::Convention::AzimuthDegrees => Convention::AzimuthDegrees,
        v1::Convention::YawFromNorth => Convention::YawFromNorth,
        v1::Convention::YawFromNorthCounterClockwise => Convention::YawFromNorthCounterClockwise,
        v1::Convention::YawClockwise => Convention::YawClockwise,
        v1::Convention::YawDegrees => Convention::YawDegrees,
        v1::Convention::LatLonSwapped => Convention::LatLonSwapped,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches codes of a later version that break a message, and a list without end.
    #[test]
    fn unknown_codes_are_passed_over() {
        let dropped = Some(v1::DroppedDetections { moving: u64::MAX, ..v1::DroppedDetections::default() });
        let told = Told::of(dropped, &[99, -1, 0, 3, 3]);
        let finding = told.mostly_moving(7).unwrap();
        assert_eq!(finding.suspects(), [Convention::RadialSpeedKmh]);
        assert_eq!(Told::of(None, &[1; 1000]).mostly_moving(0), None);
    }

    /// Catches uploads from dense traffic that are refused, and uploads in another convention that are not.
    #[test]
    fn traffic_is_no_reason_to_refuse_where_the_vehicle_has_looked() {
        let dropped = Some(v1::DroppedDetections { moving: 71, ..v1::DroppedDetections::default() });
        let clockwise = [v1::Convention::AzimuthClockwise.into()];
        assert!(Told::of(dropped, &[]).refused(29).is_some());
        assert_eq!(Told::of(dropped, &[]).inspected(true).refused(29), None);
        assert!(Told::of(dropped, &clockwise).inspected(true).refused(29).is_some());
    }

    /// Catches a suspicion that is forgotten where fewer than half were left out.
    #[test]
    fn a_suspicion_is_told_however_little_was_left_out() {
        let dropped = Some(v1::DroppedDetections { moving: 40, ..v1::DroppedDetections::default() });
        let told = Told::of(dropped, &[v1::Convention::AzimuthClockwise.into()]);
        assert_eq!(told.mostly_moving(60), None);
        assert_eq!(told.suspicion(60).unwrap().suspects(), [Convention::AzimuthClockwise]);
        assert_eq!(Told::of(dropped, &[]).suspicion(60), None);
    }
}
