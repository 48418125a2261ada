//! What operators may do: contributors, the map's past, regions in and out, backups, verification.

pub(in crate::store) mod backup;
pub(in crate::store) mod contributors;
pub(in crate::store) mod decide;
pub(in crate::store) mod history;
pub(in crate::store) mod past;
pub(in crate::store) mod region;
pub(in crate::store) mod verify;
