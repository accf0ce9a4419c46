//! How a long computation tells where it is, and learns that it shall end.

/// Receives the progress of a bake; called from many threads.
pub trait Progress: Sync {
    /// A stage begins; `total` units of work are expected (0: unknown).
    fn begin(&self, stage: &str, total: u64);
    /// `units` more are done.
    fn advance(&self, units: u64);
    /// The stage has ended.
    fn end(&self);
    /// Whether the computation shall end early; once true, always true. Asked between blocks of work, some tenths of a
    /// second each: what returns a [`Result`](crate::Result) then fails with
    /// [`Error::Interrupted`](crate::Error::Interrupted), anything else returns at once with a result that is of no use.
    fn stopped(&self) -> bool {
        false
    }
}

/// Says nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
}

/// Says nothing, but passes on that the computation shall end.
pub struct Hushed<'a>(pub &'a dyn Progress);

impl Progress for Hushed<'_> {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _units: u64) {}
    fn end(&self) {}
    fn stopped(&self) -> bool {
        self.0.stopped()
    }
}

/// An error if the computation shall end; `stage` is what it is at.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub fn go_on(progress: &dyn Progress, stage: &str) -> crate::Result<()> {
    if progress.stopped() { Err(crate::Error::Interrupted(stage.into())) } else { Ok(()) }
}
