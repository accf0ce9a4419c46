//! Locks on folders and files, so that two processes do not work on the same.
//!
//! A lock is the system's (`flock`) on a small file that also names the holder. It goes with the process, however that
//! ends: there are no stale locks, and a file that is left behind by `kill -9` or a power cut means nothing.
//!
//! On network file systems the lock holds between machines where the file system passes it on: NFS 4, and NFS 3 with
//! lockd, on Linux since 2.6.12; Lustre and BeeGFS with their `flock` options. Mounted with `nolock` or
//! `local_lock=flock` each machine has its own locks, and two machines do not see each other's. What is written is then
//! still whole, as every file is moved to its place in one step, but work may be done twice. A file system without locks
//! at all is treated likewise.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

use fs4::{FileExt, TryLockError};

use crate::{Error, Result};

/// Name of the lock file of a folder.
const NAME: &str = ".luxel.lock";

/// A lock that this process holds until it is dropped.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// Open as long as the lock is held.
    _file: File,
}

impl Lock {
    /// Locks a folder, which must be there; `work` says what for ("luxel bake").
    ///
    /// # Errors
    /// [`Error::Busy`] at once if another process holds it; [`Error::Io`] if the folder cannot be written.
    pub fn folder(folder: &Path, work: &str) -> Result<Lock> {
        Lock::take(folder, folder.join(NAME), work)
    }

    /// Locks `what` by the lock file `path`, whose folder must be there.
    ///
    /// # Errors
    /// As [`Lock::folder`].
    pub fn take(what: &Path, path: PathBuf, work: &str) -> Result<Lock> {
        loop {
            let open = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
            let mut file = open.map_err(|e| Error::io(&path, e))?;
            match FileExt::try_lock(&file) {
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::Busy { path: what.into(), holder: holder(&mut file) });
                }
                Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => {}
                Err(TryLockError::Error(e)) => return Err(Error::io(&path, e)),
            }
            // Its last holder may have removed the file between our opening and our locking it.
            if is_at(&file, &path) {
                let written = file.set_len(0).and_then(|()| writeln!(file, "{}", who(work)));
                written.map_err(|e| Error::io(&path, e))?;
                return Ok(Lock { path, _file: file });
            }
        }
    }
}

impl Lock {
    /// Who holds the lock file `path`, if anybody does. Asking holds the lock for a moment.
    pub fn holder(path: &Path) -> Option<String> {
        let mut file = File::open(path).ok()?;
        match FileExt::try_lock_shared(&file) {
            Err(TryLockError::WouldBlock) => Some(holder(&mut file)),
            _ => None,
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Before the lock goes, so that nobody else's file is removed.
        fs::remove_file(&self.path).ok();
    }
}

/// Whether `path` leads to this very file.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let same = |a: fs::Metadata, b: fs::Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
    file.metadata().is_ok_and(|a| fs::metadata(path).is_ok_and(|b| same(a, b)))
}

/// Open files cannot be removed there.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> bool {
    true
}

/// What a lock file says of its holder.
fn holder(file: &mut File) -> String {
    let mut text = String::new();
    // It may be about to be written.
    let read = file.take(256).read_to_string(&mut text);
    let text = text.trim();
    if read.is_err() || text.is_empty() { "another process".into() } else { text.into() }
}

fn who(work: &str) -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").ok().or(std::env::var("HOSTNAME").ok());
    let host = host.as_deref().map_or("this host", str::trim);
    format!("{work}, process {} on {host}, since {}", std::process::id(), utc(SystemTime::now()))
}

/// Date and time of day: `2026-01-31 23:59:58 UTC`.
fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    // Days of the proleptic Gregorian calendar, by eras of 400 years that begin in March (Hinnant, "chrono-compatible
    // low-level date algorithms", civil_from_days).
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + 400 * era + (month <= 2) as u64;
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", second / 3600, second / 60 % 60, second % 60)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_second_to_come_is_told_who_was_first() {
        let folder = tempfile::tempdir().unwrap();
        let first = Lock::folder(folder.path(), "a test").unwrap();
        let error = Lock::folder(folder.path(), "another").unwrap_err();
        let message = error.to_string();
        assert!(matches!(error, Error::Busy { .. }));
        assert!(message.starts_with(&format!("{}: in use by a test, process", folder.path().display())), "{message}");
        assert!(message.contains(&std::process::id().to_string()) && message.contains("UTC"), "{message}");
        drop(first);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        drop(Lock::folder(folder.path(), "another").unwrap());
    }

    #[test]
    fn a_file_that_was_left_behind_holds_nobody_up() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(NAME), "luxel bake, process 1 on nowhere, since long ago, and a long line")
            .unwrap();
        let lock = Lock::folder(folder.path(), "a test").unwrap();
        let text = fs::read_to_string(folder.path().join(NAME)).unwrap();
        assert!(text.starts_with("a test, process") && text.lines().count() == 1, "{text}");
        drop(lock);
    }

    #[test]
    fn one_of_many_that_come_at_once_wins() {
        let folder = tempfile::tempdir().unwrap();
        let held = std::sync::atomic::AtomicUsize::new(0);
        let taken: usize = std::thread::scope(|scope| {
            let work = || {
                let mut taken = 0;
                while taken < 20 {
                    match Lock::folder(folder.path(), "a thread") {
                        Ok(lock) => {
                            use std::sync::atomic::Ordering::SeqCst;
                            assert_eq!(held.fetch_add(1, SeqCst), 0);
                            taken += 1;
                            held.fetch_sub(1, SeqCst);
                            drop(lock);
                        }
                        Err(Error::Busy { .. }) => std::thread::yield_now(),
                        Err(other) => panic!("{other}"),
                    }
                }
                taken
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(work)).collect();
            threads.into_iter().map(|t| t.join().unwrap()).sum()
        });
        assert_eq!(taken, 80);
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        let at = |seconds| utc(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01 00:00:00 UTC");
        assert_eq!(at(951_782_399), "2000-02-28 23:59:59 UTC");
        assert_eq!(at(951_782_400), "2000-02-29 00:00:00 UTC");
        assert_eq!(at(1_798_761_599), "2026-12-31 23:59:59 UTC");
        assert_eq!(at(4_107_542_400), "2100-03-01 00:00:00 UTC");
    }
}
