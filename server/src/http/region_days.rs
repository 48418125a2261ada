//! A region's file on its way into the map, of which no tile may be from the future: the newest day of the map ages all of
//! it. The file is as the store describes it; what is no such file goes on as it is, and the store says why it is none.

use std::io::{self, Read};

use echofix_core::tile;

/// Bytes before the first tile.
const FILE_HEAD: usize = 68;
/// Bytes before a tile's own, the last four of which tell how many those are.
const TILE_HEAD: usize = 24;
/// Bytes of an encoded tile, at most: a full one stays below.
const MAX_TILE: usize = 16 << 20;

/// A reader that ends with an error at the first tile from the future.
pub(super) struct DatedRegion<R> {
    inner: R,
    today: u16,
    part: Part,
    /// Bytes of the part that came.
    came: Vec<u8>,
    refused: Option<String>,
}

/// What comes next.
enum Part {
    FileHead,
    TileHead,
    Tile(usize),
    /// Nothing that can be read here.
    Rest,
}

impl Part {
    fn bytes(&self) -> usize {
        match self {
            Self::FileHead => FILE_HEAD,
            Self::TileHead => TILE_HEAD,
            Self::Tile(bytes) => *bytes,
            Self::Rest => usize::MAX,
        }
    }
}

impl<R: Read> DatedRegion<R> {
    /// A file that is read on this day.
    pub(super) fn new(inner: R, today: u16) -> Self {
        Self { inner, today, part: Part::FileHead, came: Vec::new(), refused: None }
    }

    /// Why it was not read to its end.
    pub(super) fn refused(self) -> Option<String> {
        self.refused
    }

    fn take(&mut self, mut bytes: &[u8]) -> Option<()> {
        while !bytes.is_empty() && !matches!(self.part, Part::Rest) {
            let (part, rest) = bytes.split_at(bytes.len().min(self.part.bytes() - self.came.len()));
            self.came.extend_from_slice(part);
            bytes = rest;
            if self.came.len() == self.part.bytes() {
                self.part = self.whole()?;
                self.came.clear();
            }
        }
        Some(())
    }

    /// What follows a part that is whole; nothing when it is from the future.
    fn whole(&mut self) -> Option<Part> {
        match self.part {
            Part::FileHead => Some(Part::TileHead),
            Part::TileHead => {
                let length = self.came.last_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes) as usize);
                Some(if (1..=MAX_TILE).contains(&length) { Part::Tile(length) } else { Part::Rest })
            }
            Part::Tile(_) => self.is_dated().then_some(Part::TileHead),
            Part::Rest => Some(Part::Rest),
        }
    }

    /// Is the tile that came no more than a day ahead?
    fn is_dated(&mut self) -> bool {
        // What is no tile the store refuses.
        let Ok(tile) = tile::decode(&self.came) else { return true };
        let newest = tile.cells().iter().map(|(_, cell)| cell.last_day).max().unwrap_or(0);
        let ahead = newest.saturating_sub(self.today);
        if ahead > 1 {
            self.refused = Some(format!(
                "a tile in the file of the region was last seen {ahead} days in the future; check the clocks of this \
                 machine and of the one that made the file"
            ));
        }
        ahead <= 1
    }
}

impl<R: Read> Read for DatedRegion<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(bytes)?;
        let refused = || io::Error::new(io::ErrorKind::InvalidData, "the file is from the future");
        self.take(&bytes[..read]).ok_or_else(refused)?;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::evidence::Cell;
    use echofix_core::tile::Tile;
    use proptest::prelude::*;

    /// A file of tiles that were last seen on such days.
    fn file(days: &[u16]) -> Vec<u8> {
        let mut file = vec![0; FILE_HEAD];
        for day in days {
            let cell = Cell { hits: 1, passes: 1, first_day: 10, last_day: *day, ..Cell::default() };
            let encoded = tile::encode(&Tile::from_cells(vec![(7, cell)]).unwrap());
            file.extend([0; TILE_HEAD - 4]);
            file.extend((encoded.len() as u32).to_le_bytes());
            file.extend(encoded);
        }
        file.extend([0; 4]);
        file
    }

    /// In pieces, as a body comes.
    struct Pieces<'a>(&'a [u8], usize);

    impl Read for Pieces<'_> {
        fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
            let piece = self.1.min(bytes.len());
            self.0.read(&mut bytes[..piece])
        }
    }

    proptest! {
        /// Catches: one tile of the year 2149, by whose day all of the map is old.
        #[test]
        fn a_file_with_one_tile_of_the_future_is_refused(
            mut days in prop::collection::vec(10..20_001_u16, 1..6), ahead in 2..40_000_u16, piece in 1..200_usize, future: bool,
        ) {
            if future {
                days.push(20_000 + ahead);
            }
            let bytes = file(&days);
            let mut region = DatedRegion::new(Pieces(&bytes, piece), 20_000);
            let mut read = Vec::new();
            prop_assert_eq!(region.read_to_end(&mut read).is_err(), future);
            prop_assert_eq!(region.refused().is_some(), future);
            prop_assert!(future || read == bytes);
        }

        #[test]
        fn what_is_no_such_file_goes_on_as_it_is(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut read = Vec::new();
            DatedRegion::new(&bytes[..], 20_000).read_to_end(&mut read).unwrap();
            prop_assert_eq!(read, bytes);
        }
    }
}
