//! Files mapped into memory.
//!
//! What is mapped is not copied: the system reads pages when they are touched, and drops them again under pressure. The
//! price is that the bytes are those of the file *now*. A file that is cut short by another program while it is mapped
//! ends this process with a bus error when a lost page is touched, and one that is overwritten in place changes under
//! our eyes, after its checksums were compared. luxel itself never does either: it writes files beside their place and
//! renames them, which leaves the old content to those who have it mapped. Copy or move files over mapped ones by
//! rename too (`mv`, `rsync` without `--inplace`), not by `cp`.
#![allow(unsafe_code)]

use std::{
    fs::File,
    io,
    path::Path,
    sync::{
        Arc, Mutex, PoisonError, Weak,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
};

use bytes::Bytes;
use memmap2::Mmap;

use crate::{Error, Result};

/// The content of the file at `path`, not copied; it stays mapped as long as any part of it is in use.
///
/// # Errors
/// [`Error::Io`] if it is missing, no regular file, or cannot be read.
pub fn map(path: &Path) -> Result<Bytes> {
    let mapped = || {
        let file = File::open(path)?;
        let meta = file.metadata()?;
        if !meta.is_file() {
            return Err(io::Error::other("is no regular file"));
        }
        // The system refuses to map nothing.
        if meta.len() == 0 {
            return Ok(Bytes::new());
        }
        // SAFETY: the map is read only. That nobody changes the file's bytes while it lives is not in this program's
        // hands; it keeps to it itself (files are replaced by rename, never written in place), and the head of this file
        // tells everybody else. Readers check every index, so that changed bytes can spoil results, not memory.
        let map = unsafe { Mmap::map(&file)? };
        Ok(Bytes::from_owner(map))
    };
    mapped().map_err(|e| Error::io(path, e))
}

/// Bytes that are read from windows before their pages leave the process.
pub(crate) const WINDOWS_RESIDENT: usize = 4 << 20;

/// Parts of a file that are mapped together. Of what is read from them the process holds [`WINDOWS_RESIDENT`] at a time, about:
/// then their pages go back to the system, which has them at hand as long as it has room.
#[derive(Debug, Default)]
pub(crate) struct Windows {
    maps: Mutex<Vec<Weak<Window>>>,
    /// Bytes read since pages went the last time.
    read: AtomicUsize,
}

/// Where bytes lie makes no difference.
impl PartialEq for Windows {
    fn eq(&self, _: &Windows) -> bool {
        true
    }
}

#[derive(Debug)]
struct Window(Mmap);

/// A window as an owner of bytes.
struct Owner(Arc<Window>);

impl AsRef<[u8]> for Owner {
    fn as_ref(&self) -> &[u8] {
        &self.0.0
    }
}

impl Windows {
    /// Bytes `from .. from + length` of an open file, not copied; `from` must be a multiple of 64 KiB and `length` above 0.
    /// They may reach beyond the end of the file as long as none there is read.
    ///
    /// # Errors
    /// Those of the system.
    pub(crate) fn open(&self, file: &File, from: u64, length: usize) -> io::Result<Bytes> {
        // SAFETY: as above; the callers write every byte once, before they hand out a slice that holds it.
        let map = unsafe { memmap2::MmapOptions::new().offset(from).len(length).map(file)? };
        let window = Arc::new(Window(map));
        let mut maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        maps.retain(|map| map.strong_count() > 0);
        maps.push(Arc::downgrade(&window));
        Ok(Bytes::from_owner(Owner(window)))
    }

    /// So many bytes of them are read now.
    pub(crate) fn read(&self, bytes: usize) {
        let before = self.read.fetch_add(bytes, Relaxed);
        // One thread goes over it; the others go on.
        if before < WINDOWS_RESIDENT && before + bytes >= WINDOWS_RESIDENT {
            self.release();
            self.read.store(0, Relaxed);
        }
    }

    fn release(&self) {
        let maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        maps.iter().filter_map(Weak::upgrade).for_each(|window| window.release());
    }
}

impl Window {
    #[cfg(unix)]
    fn release(&self) {
        // SAFETY: a shared map that is never written through: its pages are those of the file, and come back with the same
        // bytes when they are touched, by whichever thread.
        // If it fails the pages stay, which is no harm.
        unsafe { self.0.unchecked_advise(memmap2::UncheckedAdvice::DontNeed) }.ok();
    }

    #[cfg(not(unix))]
    fn release(&self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_replaced_stays_as_it_was_for_those_who_mapped_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, b"old").unwrap();
        let old = map(&path).unwrap();
        std::fs::write(folder.path().join("new"), b"newer").unwrap();
        std::fs::rename(folder.path().join("new"), &path).unwrap();
        assert_eq!((&*old, &*map(&path).unwrap()), (&b"old"[..], &b"newer"[..]));
    }

    #[test]
    fn an_empty_file_has_no_bytes_and_a_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, b"").unwrap();
        assert!(map(&path).unwrap().is_empty());
        let message = map(folder.path()).unwrap_err().to_string();
        assert!(message.contains("no regular file"), "{message}");
    }
}
