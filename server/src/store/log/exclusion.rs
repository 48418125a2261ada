//! What of the journal does not count, by the controls in it.

use std::collections::{BTreeMap, HashMap, HashSet};

use uuid::Uuid;

use super::entry::{Action, Control, RecordKind};

/// The records that some controls exclude. A control speaks about earlier records only: what a revoked
/// contributor sends later counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(in crate::store) struct Exclusion {
    /// Rolled back: (last that counts, first that counts again).
    ranges: Vec<(u64, u64)>,
    /// Revoked contributors, and the first record that counts again.
    contributors: HashMap<u64, u64>,
    uploads: HashSet<u64>,
    /// Revoked files, and the first record that counts again.
    files: HashMap<Uuid, u64>,
}

/// The controls up to one that are not undone by a later one of them, in order. Undoing an undoing brings the first one
/// back.
pub(in crate::store) fn in_effect(controls: &BTreeMap<u64, Control>, up_to: u64) -> Vec<(u64, Action)> {
    let mut undone = HashSet::new();
    let mut found = Vec::new();
    for (number, control) in controls.range(..=up_to).rev() {
        if undone.contains(number) {
            continue;
        }
        if let Action::Undo(earlier) = control.action
            && earlier < *number
        {
            undone.insert(earlier);
        }
        found.push((*number, control.action));
    }
    found.reverse();
    found
}

impl Exclusion {
    /// Adds the control of a number, which is in effect; `number_of` knows the uploads of the journal. Controls come in
    /// order of their numbers.
    pub(in crate::store) fn add(
        &mut self,
        number: u64,
        action: Action,
        number_of: impl Fn(Uuid) -> Option<u64>,
    ) {
        match action {
            Action::RevokeContributor(contributor) => {
                self.contributors.insert(contributor, number);
            }
            Action::RevokeUpload(id) => {
                self.uploads.extend(number_of(id).filter(|upload| *upload < number));
                self.files.insert(id, number);
            }
            Action::Rollback(epoch) => self.ranges.push((epoch, number)),
            // What is undone is not added in the first place.
            Action::Undo(_) | Action::Compact(_) => {}
        }
    }

    /// Does this record not count?
    pub(in crate::store) fn excludes(&self, number: u64, kind: RecordKind) -> bool {
        let rolled_back = || self.ranges.iter().any(|(last, again)| (last + 1..*again).contains(&number));
        match kind {
            RecordKind::Upload { contributor } => {
                self.uploads.contains(&number)
                    || self.contributors.get(&contributor).is_some_and(|again| number < *again)
                    || rolled_back()
            }
            RecordKind::Import { file } => {
                self.files.get(&file).is_some_and(|again| number < *again) || rolled_back()
            }
            RecordKind::Control => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a rollback that stays although it was undone, and one that stays undone although that was undone.
    #[test]
    fn what_is_undone_has_no_effect_until_that_is_undone() {
        let control = |action| Control { at_us: 0, action, remark: crate::store::api::Remark::default() };
        let controls: BTreeMap<_, _> = [
            (5, control(Action::Rollback(2))),
            (6, control(Action::RevokeContributor(7))),
            (8, control(Action::Undo(5))),
            (9, control(Action::Undo(8))),
            (10, control(Action::Undo(9))),
        ]
        .into();
        let at =
            |up_to| in_effect(&controls, up_to).into_iter().map(|(number, _)| number).collect::<Vec<_>>();
        assert_eq!(at(7), [5, 6]);
        assert_eq!(at(8), [6, 8]);
        assert_eq!(at(9), [5, 6, 9]);
        assert_eq!(at(u64::MAX), [6, 8, 10]);
    }

    #[test]
    fn controls_exclude_what_came_before_them_and_nothing_later() {
        let id = Uuid::from_u128(9);
        let mut exclusion = Exclusion::default();
        exclusion.add(10, Action::RevokeContributor(7), |_| None);
        exclusion.add(11, Action::RevokeUpload(id), |asked| (asked == id).then_some(4));
        exclusion.add(12, Action::Rollback(8), |_| None);
        exclusion.add(13, Action::Compact(5), |_| None);
        let by = |contributor| RecordKind::Upload { contributor };
        let excluded = |kind| (1..16).filter(|number| exclusion.excludes(*number, kind)).collect::<Vec<_>>();
        assert_eq!(excluded(by(7)), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], "its own and the rolled back");
        assert_eq!(excluded(by(1)), [4, 9, 10, 11]);
        assert_eq!(excluded(RecordKind::Import { file: id }), (1..12).collect::<Vec<_>>());
        assert_eq!(excluded(RecordKind::Import { file: Uuid::nil() }), [9, 10, 11]);
        assert_eq!(excluded(RecordKind::Control), [0; 0]);
    }
}
