//! How far the journal reaches and how far it is folded.

/// Can the map be read?
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapStatus {
    /// Not yet: it does not show all uploads that were counted before the start.
    #[default]
    Rebuilding,
    /// Yes.
    Serving,
    /// As of the epoch; folding on fails and is tried again.
    Stalled,
}

/// How far the journal reaches and how far it is folded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MapProgress {
    /// Can the map be read?
    pub state: MapStatus,
    /// Epoch of the map that is served: the number of the last record folded into it.
    pub epoch: u64,
    /// Number of the last record in the journal.
    pub journaled: u64,
    /// A new generation of the map that is being made, under a control. What is served meanwhile, if
    /// anything, does not show the control yet.
    pub building: Option<Building>,
    /// The journal accepts nothing any more, see [`super::Error::Stopped`].
    pub stopped: bool,
    /// The journal could not be written the last time; it is tried again.
    pub refusing: bool,
}

/// A generation of the map that is being made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Building {
    /// The last record folded into it.
    pub folded: u64,
    /// Number of the last record in the journal.
    pub of: u64,
    /// Number of the control it is made under; 0 when it replaces lost tiles.
    pub control: u64,
}
