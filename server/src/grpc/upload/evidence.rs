//! Evidence that a vehicle gathered itself: what the service can check, it checks.

use std::collections::BTreeMap;

use echofix_core::datum::PoseSigma;
use echofix_core::evidence::EvidenceDelta;
use echofix_core::evidence::build::{BuildError, BuiltEvidence};
use echofix_core::evidence::codec::{self, DeltaLimits};
use echofix_core::gate::Dropped;
use echofix_core::geo::Zone;
use echofix_core::tile::DecodeError;
use echofix_proto::v1::EvidenceChunk;

use super::Error;
use crate::grpc::invalid_field::{InvalidField, require};
use crate::mapping::MappingConfig;

/// Hits that one upload may have in one cell: more than radars make in the seconds it spans.
const MAX_CELL_HITS: u32 = 4_096;

/// The pieces of a contribution.
#[derive(Debug, Default)]
pub(super) struct Evidence {
    bytes: Vec<u8>,
    sigma_position_m: f64,
    sigma_yaw_rad: f64,
}

impl Evidence {
    pub(super) fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Takes the next piece.
    pub(super) fn add(&mut self, chunk: &EvidenceChunk) -> Result<(), InvalidField> {
        require(!chunk.contribution.is_empty(), "evidence.contribution", "is empty")?;
        if self.is_empty() {
            let sigma = |value: f32, field| {
                require(value.is_finite() && value >= 0.0, field, "must be finite and not negative")?;
                Ok(f64::from(value))
            };
            self.sigma_position_m = sigma(chunk.sigma_position_m, "evidence.sigma_position_m")?;
            self.sigma_yaw_rad = sigma(chunk.sigma_yaw_rad, "evidence.sigma_yaw_rad")?;
        }
        self.bytes.extend_from_slice(&chunk.contribution);
        Ok(())
    }

    /// The contribution, if it could have come from a vehicle that keeps to the limits.
    pub(super) fn checked(mut self, config: &MappingConfig) -> Result<BuiltEvidence, Error> {
        let limits = config.limits();
        if self.sigma_position_m > limits.segments.max_sigma_position_m
            || self.sigma_yaw_rad > limits.segments.max_sigma_yaw_rad
        {
            let (position_m, yaw_deg) = (config.max_sigma_position_m, config.max_sigma_yaw_deg);
            return Err(BuildError::PoseTooUncertain { position_m, yaw_deg }.into());
        }
        let invalid = |why: &dyn std::fmt::Display| Error::Evidence(why.to_string());
        // A cell was hit once at least, so that an upload has no more cells than detections.
        let room = DeltaLimits { tiles: limits.max_tiles, cells: config.max_upload_detections };
        let contribution = codec::decode_within(&self.bytes, room).map_err(|error| match error {
            DecodeError::TooManyTiles { found: tiles, most } => {
                BuildError::TooManyTiles { tiles, most }.into()
            }
            error => invalid(&error),
        })?;
        // The largest part of an upload while it waits to be checked.
        drop(std::mem::take(&mut self.bytes));
        let detections = detections(&contribution);
        if detections == 0 {
            return Err(BuildError::NoDetections { sent: 0 }.into());
        }
        let counted = |evidence: &echofix_core::evidence::TileEvidence| {
            evidence.cells.iter().all(|c| c.hits <= MAX_CELL_HITS)
        };
        if !contribution.tiles.values().all(counted) {
            return Err(invalid(&format!("a cell has more than {MAX_CELL_HITS} hits")));
        }
        if detections > config.max_upload_detections as u64 {
            let most = config.max_upload_detections;
            return Err(invalid(&format!("it holds more than {most} detections; split the upload")));
        }
        if contribution.tiles.keys().any(|id| !id.lies_on_grid()) {
            return Err(invalid(&"a tile lies outside its zone"));
        }
        // The journal gets an encoding that is made anew, and not the bytes as they came. Their head holds the vehicle's own
        // count of detections, which nothing checks and the answer repeats: it is replaced by what the cells add up to. And
        // whatever library encoded them, equal evidence then gives the same record. Folding decodes the record, not this
        // value, so that it does the same now and at a replay.
        let contribution = EvidenceDelta { detections, ..contribution };
        let sigma = PoseSigma::declared(self.sigma_position_m, self.sigma_yaw_rad);
        Ok(BuiltEvidence { delta: contribution, dropped: Dropped::default(), sigma })
    }
}

/// Detections; those of a zone border are in several zones and count once.
fn detections(contribution: &EvidenceDelta) -> u64 {
    let mut by_zone: BTreeMap<Zone, u64> = BTreeMap::new();
    for (id, evidence) in &contribution.tiles {
        *by_zone.entry(id.zone).or_default() += evidence.detections();
    }
    by_zone.into_values().max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::evidence::{CellHits, TileEvidence};
    use echofix_core::geo::TileId;

    fn contribution(cells: u32, hits: u32, x: i32) -> EvidenceDelta {
        let id = TileId { zone: Zone::from_epsg(32614).unwrap(), y: 65_000, x };
        let hit = |index| CellHits { index, hits, offset_sum: [hits, hits] };
        let evidence = TileEvidence::of_hits((0..cells).map(hit).collect());
        EvidenceDelta { tiles: [(id, evidence)].into(), detections: u64::MAX }
    }

    fn checked(contribution: &EvidenceDelta, sigma_position_m: f32) -> Result<BuiltEvidence, Error> {
        let mut evidence = Evidence::default();
        for piece in codec::encode(contribution).chunks(100) {
            let chunk =
                EvidenceChunk { contribution: piece.to_vec(), sigma_position_m, sigma_yaw_rad: 0.001 };
            evidence.add(&chunk).unwrap();
        }
        evidence.checked(&MappingConfig::default())
    }

    #[test]
    fn sound_evidence_is_taken_and_its_detections_are_counted_here() {
        let counted = checked(&contribution(700, 3, 12_000), 0.1).unwrap();
        assert_eq!(counted.delta, EvidenceDelta { detections: 2_100, ..contribution(700, 3, 12_000) });
    }

    #[test]
    fn evidence_that_no_vehicle_could_have_gathered_is_refused() {
        let reason = |contribution: &EvidenceDelta, sigma| checked(contribution, sigma).unwrap_err().reason();
        assert_eq!(reason(&contribution(10, 3, 12_000), 0.5), "POSE_TOO_UNCERTAIN");
        // In single precision the limit of 0.3 m is a little more than that.
        assert!(checked(&contribution(10, 3, 12_000), 0.3).is_ok());
        assert_eq!(reason(&contribution(10, MAX_CELL_HITS + 1, 12_000), 0.1), "INVALID");
        assert_eq!(reason(&contribution(10, 3, -7), 0.1), "INVALID");
        assert_eq!(reason(&contribution(200_000, 3, 12_000), 0.1), "INVALID");
        assert_eq!(reason(&contribution(0, 1, 12_000), 0.1), "NO_DETECTIONS");
        let mut evidence = Evidence::default();
        let noise = EvidenceChunk { contribution: vec![7; 100], ..EvidenceChunk::default() };
        evidence.add(&noise).unwrap();
        assert_eq!(evidence.checked(&MappingConfig::default()).unwrap_err().reason(), "INVALID");
        let empty = EvidenceChunk::default();
        assert_eq!(Evidence::default().add(&empty).unwrap_err().field, "evidence.contribution");
        let nan = EvidenceChunk { sigma_yaw_rad: f32::NAN, ..noise };
        assert_eq!(Evidence::default().add(&nan).unwrap_err().field, "evidence.sigma_yaw_rad");
    }
}
