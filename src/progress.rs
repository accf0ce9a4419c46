//! How a long computation tells where it is.

/// Receives the progress of a bake; called from many threads.
pub trait Progress: Sync {
    /// A stage begins; `total` units of work are expected (0: unknown).
    fn begin(&self, stage: &str, total: u64);
    /// `units` more are done.
    fn advance(&self, units: u64);
    /// The stage has ended.
    fn end(&self);
}

/// Says nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
}
