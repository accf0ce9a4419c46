//! What can go wrong, by what the caller can do about it.

use std::{io, path::PathBuf};

/// The result of every fallible call of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// An error of luxel. Every message names the place and, where there is one, the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written: check the path, the rights, the disk.
    #[error("{}: {source}{}", path.display(), remedy(source.kind()))]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The content of an input file is wrong: mend the file at the place named.
    #[error("{}: {place}{message}", path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// `line 12: `, `mesh "wall", face 3: ` or empty.
        place: String,
        /// What is wrong and what would be right.
        message: String,
    },
    /// The scene as a whole cannot be baked (no geometry, no light ...): change the scene or the options.
    #[error("{0}")]
    Scene(String),
    /// An option has no sense, or not in this combination: change the option.
    #[error("{0}")]
    Option(String),
    /// A bake was stopped because its time was over; it has no result.
    #[error("the time was over when stage \"{0}\" ended")]
    Stopped(String),
    /// Another process works on the same folder or file: wait for it, or choose another one.
    #[error("{}: in use by {holder}; wait for it, or choose another one", path.display())]
    Busy {
        /// The folder or file.
        path: PathBuf,
        /// Who works on it, and since when.
        holder: String,
    },
    /// The computation was asked to end ([`Progress::stopped`](crate::progress::Progress::stopped)) and did, in the stage
    /// named; it has no result.
    #[error("interrupted in stage \"{0}\"")]
    Interrupted(String),
    /// Shards of a plan are missing, cut off, damaged or foreign: run the commands that the message names.
    #[error("{}: {flaws}", path.display())]
    Shards {
        /// The folder of the plan.
        path: PathBuf,
        /// The shards, what is wrong with each, and what mends it.
        flaws: String,
    },
    /// A ray-tracing or image backend is absent or failed: choose another one.
    #[error("{0}")]
    Backend(String),
    /// The scheduler of a farm is absent or refuses: its own words say what to change.
    #[error("{0}")]
    Scheduler(String),
}

/// What helps against a failure of the system, where that is not plain.
fn remedy(kind: io::ErrorKind) -> &'static str {
    use io::ErrorKind::{FileTooLarge, PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match kind {
        StorageFull => "; the disk is full: make room, or choose a folder on another disk",
        QuotaExceeded => "; your share of the disk is used up: make room, or choose a folder on another disk",
        FileTooLarge => {
            "; the file is larger than the disk or `ulimit -f` allows: choose another folder, or raise the limit"
        }
        ReadOnlyFilesystem => "; the disk is mounted read-only: choose another folder",
        PermissionDenied => "; check the rights of the file and its folder, or choose another folder",
        _ => "",
    }
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: impl Into<PathBuf>, source: io::Error) -> Error {
        Error::Io { path: path.into(), source }
    }

    /// An [`Error::Input`] for `path`; `place` is e.g. `line 12` or empty.
    pub fn input(path: impl Into<PathBuf>, place: impl Into<String>, message: impl Into<String>) -> Error {
        let mut place = place.into();
        if !place.is_empty() {
            place.push_str(": ");
        }
        Error::Input { path: path.into(), place, message: message.into() }
    }
}
