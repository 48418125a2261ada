//! Tiles of the pieces they come in.

use echofix_core::geo::TileId;
use echofix_proto::v1::{TileData, TilePiece};

use super::Error;
use crate::wire::tile_id;

/// Bytes of an encoded tile, at most: a full one stays below.
const MAX_TILE: u64 = 16 << 20;

/// A tile that came whole, not yet decoded.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Whole {
    pub(super) id: TileId,
    pub(super) version: u64,
    pub(super) encoded: Vec<u8>,
}

/// The tile that is under way.
#[derive(Debug, Default)]
pub(super) struct Assembly(Option<(Whole, u64)>);

impl Assembly {
    /// A tile begins; returned when that is all of it.
    pub(super) fn begin(&mut self, data: TileData) -> Result<Option<Whole>, Error> {
        self.end()?;
        if data.encoded_bytes > MAX_TILE {
            return Err(Error::Contract("a tile is larger than any can be"));
        }
        let version = data.version.ok_or(Error::Contract("a tile has no version"))?;
        let id = version.tile.as_ref().and_then(tile_id).ok_or(Error::Contract("a tile has no id"))?;
        self.0 = Some((Whole { id, version: version.version, encoded: Vec::new() }, data.encoded_bytes));
        self.extend(data.encoded)
    }

    /// The tile goes on; returned when that was the last of it.
    pub(super) fn go_on(&mut self, piece: TilePiece) -> Result<Option<Whole>, Error> {
        self.extend(piece.encoded)
    }

    /// No tile may be under way.
    pub(super) fn end(&self) -> Result<(), Error> {
        if self.0.is_some() { Err(Error::Contract("a tile breaks off")) } else { Ok(()) }
    }

    fn extend(&mut self, piece: Vec<u8>) -> Result<Option<Whole>, Error> {
        let (whole, bytes) = self.0.as_mut().ok_or(Error::Contract("a piece belongs to no tile"))?;
        if whole.encoded.is_empty() {
            whole.encoded = piece;
        } else {
            whole.encoded.extend(piece);
        }
        match (whole.encoded.len() as u64).cmp(bytes) {
            std::cmp::Ordering::Less => Ok(None),
            std::cmp::Ordering::Equal => Ok(self.0.take().map(|(whole, _)| whole)),
            std::cmp::Ordering::Greater => Err(Error::Contract("a tile is longer than it says")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_proto::v1;
    use proptest::prelude::*;

    fn first(bytes: &[u8], encoded_bytes: usize) -> TileData {
        let tile = Some(v1::TileId { epsg: 32614, x: 3, y: 4 });
        let version = Some(v1::TileVersion { tile, version: 7 });
        TileData { version, encoded: bytes.to_vec(), encoded_bytes: encoded_bytes as u64 }
    }

    proptest! {
        /// Breaks when a piece is lost, comes twice or ends a tile too early.
        #[test]
        fn pieces_of_any_size_come_to_the_tile(bytes in prop::collection::vec(any::<u8>(), 1..500), size in 1..600_usize) {
            let mut assembly = Assembly::default();
            let mut pieces = bytes.chunks(size);
            let mut whole = assembly.begin(first(pieces.next().unwrap(), bytes.len())).unwrap();
            for piece in pieces {
                prop_assert_eq!(whole, None);
                whole = assembly.go_on(TilePiece { encoded: piece.to_vec() }).unwrap();
            }
            prop_assert_eq!(whole.unwrap().encoded, bytes);
            prop_assert!(assembly.end().is_ok());
        }
    }

    #[test]
    fn what_breaks_the_contract_is_refused() {
        let piece = |bytes: &[u8]| TilePiece { encoded: bytes.to_vec() };
        assert!(Assembly::default().go_on(piece(b"x")).is_err());
        assert!(Assembly::default().begin(first(b"long", 3)).is_err());
        assert!(Assembly::default().begin(first(b"", 1 << 40)).is_err());
        assert!(Assembly::default().begin(TileData::default()).is_err());
        let mut assembly = Assembly::default();
        assert_eq!(assembly.begin(first(b"ab", 4)).unwrap(), None);
        assert!(assembly.end().is_err() && assembly.begin(first(b"ab", 2)).is_err());
        assert!(assembly.go_on(piece(b"cde")).is_err());
    }
}
