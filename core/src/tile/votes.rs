//! The votes of a pass in one tile, and their bytes.

use super::CELLS;
use crate::evidence::ViewBlocks;
use crate::evidence::codec::{blocks, put_blocks};
use crate::varint::{VarintReader, VarintWriter, Varints};

/// What a pass hit and had in view in one tile.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Votes {
    /// Cells it hit, in order.
    pub(super) cells: Vec<u32>,
    /// Blocks it had in view.
    pub(super) observed: ViewBlocks,
}

/// The same in bytes: of the many passes of a busy street, an upload concerns those of its own contributor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct EncodedVotes {
    cells: usize,
    bytes: Box<[u8]>,
}

impl EncodedVotes {
    pub(super) fn of(votes: &Votes) -> Self {
        let mut out = VarintWriter::default();
        out.put(votes.cells.len() as u64);
        out.put_ascending(votes.cells.iter().copied());
        put_blocks(&mut out, &votes.observed);
        Self { cells: votes.cells.len(), bytes: out.bytes.into_boxed_slice() }
    }

    /// Takes them off a ledger's columns; `None` where they break the format.
    pub(super) fn take(input: &mut impl Varints) -> Option<Self> {
        Some(Self::of(&read(input)?))
    }

    pub(super) fn votes(&self) -> Votes {
        read(&mut VarintReader { rest: &self.bytes }).expect("they were written here, or read once before")
    }

    /// Number of cells that were hit.
    pub(super) fn cells(&self) -> usize {
        self.cells
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

fn read(input: &mut impl Varints) -> Option<Votes> {
    let count = input.count_of(1)?;
    let mut cells = Vec::new();
    input.ascending(count, CELLS, &mut cells)?;
    Some(Votes { cells, observed: blocks(input)? })
}
