//! What can go wrong, by what the caller can do about it.

use std::path::PathBuf;

/// The result of every fallible call of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// An error of luxel. Every message names the place and, where there is one, the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read or written: check the path, the rights, the disk.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
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
    /// A ray-tracing or image backend is absent or failed: choose another one.
    #[error("{0}")]
    Backend(String),
    /// The scheduler of a farm is absent or refuses: its own words say what to change.
    #[error("{0}")]
    Scheduler(String),
}

impl Error {
    /// An [`Error::Io`] for `path`.
    pub fn io(path: impl Into<PathBuf>, source: std::io::Error) -> Error {
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
