//! The quarantine: uploads that vetting kept out of the map, stored beside the tiles.
//!
//! ```text
//! key    "quarantined" | number of the record (8), big-endian
//! value  CRC-32C of key and the rest (4) | varints: EPSG code, east and north (zigzag, mm), day, reason, offset
//! known (0, 1), offset east, north (zigzag, mm), turn (zigzag, urad) | contributor hash (8)
//! ```

use echofix_core::datum::Offset;
use echofix_core::geo::Zone;
use echofix_core::point::MapPoint;
use echofix_core::varint::{VarintReader, VarintWriter};
use echofix_core::vetting::Reason;
use echofix_core::vetting::alarm::QuarantinedUpload;

use crate::store::api::QuarantinedRecord;
use crate::store::checksum::{SUM, seal, sealed};

/// How the keys begin: longer than a tile's.
pub(super) const PREFIX: &[u8] = b"quarantined";

pub(super) fn is_key(key: &[u8]) -> bool {
    key.starts_with(PREFIX)
}

pub(in crate::store) fn key(number: u64) -> Vec<u8> {
    [PREFIX, &number.to_be_bytes()].concat()
}

pub(in crate::store) fn encode(quarantined: &QuarantinedRecord) -> Vec<u8> {
    let QuarantinedRecord { number, reason, upload } = quarantined;
    let mut out = VarintWriter { bytes: vec![0; SUM] };
    out.put(u64::from(upload.zone.epsg()));
    for metres in [upload.position.x_m, upload.position.y_m] {
        out.put_signed((metres * 1e3).round() as i64);
    }
    out.put(u64::from(upload.day));
    out.put(match reason {
        Reason::Shifted => 0,
        Reason::Rotated => 1,
        Reason::Disagrees => 2,
    });
    out.put(u64::from(upload.offset.is_some()));
    let Offset { east_mm, north_mm, yaw_urad } = upload.offset.unwrap_or_default();
    for part in [east_mm, north_mm, yaw_urad] {
        out.put_signed(part.into());
    }
    out.bytes.extend_from_slice(&upload.contributor.to_le_bytes());
    seal(&mut out.bytes, &key(*number));
    out.bytes
}

pub(in crate::store) fn decode(key: &[u8], value: &[u8]) -> Option<QuarantinedRecord> {
    let number = u64::from_be_bytes(key.strip_prefix(PREFIX)?.try_into().ok()?);
    let mut input = VarintReader { rest: sealed(value, key)? };
    let zone = Zone::from_epsg(input.get()?).ok()?;
    let mut metres = || Some(input.get_signed::<i64>()? as f64 * 1e-3);
    let position = MapPoint::new(metres()?, metres()?);
    let day = input.get()?;
    let reason = match input.get::<u8>()? {
        0 => Reason::Shifted,
        1 => Reason::Rotated,
        2 => Reason::Disagrees,
        _ => return None,
    };
    let known = input.get::<u8>()? == 1;
    let offset =
        Offset { east_mm: input.get_signed()?, north_mm: input.get_signed()?, yaw_urad: input.get_signed()? };
    let contributor = u64::from_le_bytes(input.rest.try_into().ok()?);
    let upload = QuarantinedUpload { zone, position, offset: known.then_some(offset), contributor, day };
    Some(QuarantinedRecord { number, reason, upload })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_note_survives_its_bytes_and_a_changed_one_does_not(
            number: u64, place in [100_000.0..900_000.0_f64, 0.0..9e6_f64], day: u16, contributor: u64,
            offset in prop::option::of((any::<i16>(), any::<i16>(), any::<i16>())), reason in 0..3_usize,
            at: prop::sample::Index, bit in 0..8_u8,
        ) {
            let offset = offset.map(|(e, n, y)| Offset { east_mm: e.into(), north_mm: n.into(), yaw_urad: y.into() });
            let position = MapPoint::from(place.map(|m| (m * 1e3).round() * 1e-3));
            let zone = Zone::from_epsg(32614).unwrap();
            let reason = [Reason::Shifted, Reason::Rotated, Reason::Disagrees][reason];
            let note = QuarantinedRecord { number, reason, upload: QuarantinedUpload { zone, position, offset, contributor, day } };
            let (key, mut value) = (key(number), encode(&note));
            let back = decode(&key, &value).unwrap();
            prop_assert!(back.upload.position.distance_m(position) < 1e-6);
            prop_assert_eq!(QuarantinedRecord { upload: QuarantinedUpload { position, ..back.upload }, ..back }, note);
            let at = at.index(value.len());
            value[at] ^= 1 << bit;
            prop_assert_eq!(decode(&key, &value), None);
        }
    }
}
