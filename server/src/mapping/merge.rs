//! Contributions of the stretches of one upload become one.

use std::collections::btree_map::Entry;

use echofix_core::evidence::{CellHits, Contribution};

/// Adds the tiles of `other`, not its count of detections.
pub(super) fn merge(into: &mut Contribution, other: Contribution) {
    for (id, cells) in other.tiles {
        match into.tiles.entry(id) {
            Entry::Vacant(place) => drop(place.insert(cells)),
            Entry::Occupied(mut place) => {
                let merged = merged(place.get(), &cells);
                place.insert(merged);
            }
        }
    }
}

/// Two lists in order of their indices as one.
fn merged(a: &[CellHits], b: &[CellHits]) -> Vec<CellHits> {
    let mut all: Vec<CellHits> = Vec::with_capacity(a.len() + b.len());
    let (mut a, mut b) = (a.iter().peekable(), b.iter().peekable());
    loop {
        let from_a = match (a.peek(), b.peek()) {
            (Some(a), Some(b)) => a.index <= b.index,
            (a, b) if a.is_none() && b.is_none() => return all,
            (a, _) => a.is_some(),
        };
        let next = if from_a { a.next() } else { b.next() };
        let Some(next) = next else { return all };
        match all.last_mut().filter(|last| last.index == next.index) {
            Some(last) => {
                last.hits += next.hits;
                last.offset_sum = [0, 1].map(|axis| last.offset_sum[axis] + next.offset_sum[axis]);
            }
            None => all.push(*next),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn cells() -> impl Strategy<Value = BTreeMap<u32, u32>> {
        prop::collection::btree_map(0..50_u32, 1..5_u32, 0..30)
    }

    fn hits(cells: &BTreeMap<u32, u32>) -> Vec<CellHits> {
        cells
            .iter()
            .map(|(index, hits)| CellHits { index: *index, hits: *hits, offset_sum: [*hits, 2 * hits] })
            .collect()
    }

    proptest! {
        #[test]
        fn hits_add_up_in_order(a in cells(), b in cells()) {
            let mut sum = a.clone();
            for (index, hits) in &b {
                *sum.entry(*index).or_default() += hits;
            }
            prop_assert_eq!(merged(&hits(&a), &hits(&b)), hits(&sum));
        }
    }
}
