//! What every backend must do: one function for each rule, and a macro that runs all of them on a backend.

pub(in crate::store) mod files;
pub(in crate::store) mod tables;

use super::Backend;

/// Where backends are opened, one after the other.
pub(in crate::store) trait Place {
    /// Opens it; who had it before has dropped it.
    fn open(&self) -> Backend;
}

/// Makes a test of each rule.
macro_rules! conforms {
    ($place:expr, { $($layer:ident: [$($rule:ident),* $(,)?]),* $(,)? }) => {
        $($(
            #[test]
            fn $rule() {
                $crate::store::backend::conformance::$layer::$rule(&$place);
            }
        )*)*
    };
    ($place:expr) => {
        $crate::store::backend::conformance::conforms!($place, {
            files: [
                an_object_is_whole_and_stays,
                a_name_is_given_once,
                of_racing_puts_one_wins,
                a_put_that_fails_leaves_nothing,
                an_opened_object_outlives_its_name,
                deleting_what_is_not_there_is_no_error,
                a_segment_holds_what_was_synced,
                a_segment_is_begun_once,
                who_writes_to_a_replaced_segment_writes_nowhere,
                a_segment_is_cut_and_goes_on,
                segments_are_listed_in_order_and_deleted,
                the_newest_manifest_counts,
                a_manifest_that_is_set_aside_is_none,
                who_was_taken_over_publishes_nothing,
                pseudonyms_keep_their_hashes,
            ],
            tables: [
                a_table_gives_what_was_put,
                entries_come_in_the_order_of_their_keys,
                a_batch_survives_the_table,
                a_table_says_what_it_was_made_from,
                a_table_is_made_once,
                a_table_that_is_not_there_is_none,
                a_retired_table_goes_when_it_is_dropped,
                numbers_are_free,
                cleaning_leaves_what_is_served,
            ],
        });
    };
}
pub(in crate::store) use conforms;

mod memory {
    use super::*;
    use crate::store::backend::memory::Memory;

    impl Place for Memory {
        fn open(&self) -> Backend {
            Self::open(self)
        }
    }

    conforms!(Memory::default());
}

/// What wraps a backend and lets nothing fail must change nothing.
mod faulty {
    use super::*;
    use crate::store::backend::faulty::Faults;
    use crate::store::backend::memory::Memory;

    struct Wrapped(Memory);

    impl Place for Wrapped {
        fn open(&self) -> Backend {
            Faults::default().around(self.0.open())
        }
    }

    conforms!(Wrapped(Memory::default()));
}
