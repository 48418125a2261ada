//! The ways to ask.

use super::batch::{BatchForm, Fault};
use super::prior::PriorLie;

/// Where the vehicle is that asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In a mapped street.
    Mapped,
    /// Near the end of the mapped part.
    MapEnds,
    /// In a street of the same kind that nobody mapped, believed in a mapped one.
    Unmapped,
}

/// A way to ask.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its name in tables.
    pub name: String,
    /// The number that varies among cases of one kind; 0 without one.
    pub k: f64,
    /// Where the vehicle is.
    pub place: Place,
    /// Its batch.
    pub form: BatchForm,
    /// Its prior.
    pub lie: PriorLie,
    /// Priors per batch.
    pub priors: usize,
}

/// The usual batch.
const USUAL: BatchForm = BatchForm { length_s: 5.0, fault: Fault::None, declared: false };

/// All ways to ask, or a few.
pub fn cases(quick: bool) -> Vec<Case> {
    let mut all = lies(quick);
    let mut add = |name: &str, k: f64, place: Place, form: BatchForm| {
        let priors = if quick { 1 } else { 2 };
        all.push(Case { name: name.to_owned(), k, place, form, lie: PriorLie::Honest, priors });
    };
    add("right, errors declared", 0.0, Place::Mapped, BatchForm { declared: true, ..USUAL });
    add("map ends", 0.0, Place::MapEnds, USUAL);
    add("unmapped street", 0.0, Place::Unmapped, USUAL);
    let lengths: &[f64] = if quick { &[1.0, 8.0] } else { &[1.0, 3.0, 8.0] };
    for length_s in lengths {
        let form = BatchForm { length_s: *length_s, ..USUAL };
        add(&format!("batch of {length_s:.0} s"), *length_s, Place::Mapped, form);
    }
    for (name, k, fault) in faults(quick) {
        add(&name, k, Place::Mapped, BatchForm { fault, ..USUAL });
    }
    all
}

/// Cases whose prior lies, and the one whose prior does not.
fn lies(quick: bool) -> Vec<Case> {
    let mut all = Vec::new();
    let mut add = |name: &str, k: f64, lie: PriorLie, priors: usize| {
        let priors = if quick { priors.div_ceil(4) } else { priors };
        all.push(Case { name: name.to_owned(), k, place: Place::Mapped, form: USUAL, lie, priors });
    };
    add("right", 0.0, PriorLie::Honest, 8);
    let sigmas: &[u32] = if quick { &[0, 4, 6] } else { &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10] };
    for k in sigmas.iter().copied().map(f64::from) {
        add(&format!("{k:.0} sigma along"), k, PriorLie::Along(k), 2);
        // Without an offset there is no direction.
        if k > 0.0 {
            add(&format!("{k:.0} sigma across"), k, PriorLie::Across(k), 2);
        }
    }
    add("8 m off", 8.0, PriorLie::Metres(8.0, 8.0), 4);
    add("12 to 30 m off", 21.0, PriorLie::Metres(12.0, 30.0), 8);
    add("wrong street", 100.0, PriorLie::WrongStreet, 4);
    all
}

fn faults(quick: bool) -> Vec<(String, f64, Fault)> {
    let named = |name: &str, k: f64, fault| (name.to_owned(), k, fault);
    let late = |ms: f64| named(&format!("clock late {ms:.0} ms"), ms, Fault::LateClock(ms));
    let jump = |ahead_m: f64, before_s: f64| {
        named(
            &format!("odometry jumps {ahead_m:.0} m {before_s} s before"),
            ahead_m,
            Fault::Jump { ahead_m, before_s },
        )
    };
    let mut all =
        vec![named("no Doppler", 0.0, Fault::NoDoppler), named("drift", 0.0, Fault::Drift), late(50.0)];
    all.push(jump(5.0, 0.5));
    if quick {
        return all;
    }
    all.extend([
        jump(1.0, 0.2),
        named("odometry jumps 3 m every 4 s", 3.0, Fault::Jumps { ahead_m: 3.0, every_s: 4.0 }),
        late(20.0),
        late(100.0),
        named("mounts turned 1 deg", 1.0, Fault::TurnedMounts(1.0)),
        named("one mount turned 2 deg", 2.0, Fault::TurnedMount(2.0)),
        named("mounts 10 cm ahead", 0.1, Fault::ShiftedMounts(0.1)),
    ]);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn cases_have_names_of_their_own_and_a_quick_run_asks_some_of_them() {
        let names = |quick| cases(quick).into_iter().map(|case| case.name).collect::<BTreeSet<_>>();
        let (all, few) = (names(false), names(true));
        assert_eq!(all.len(), cases(false).len());
        assert!(few.is_subset(&all) && few.len() < all.len());
    }
}
