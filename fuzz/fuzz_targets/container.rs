//! Any bytes as a container: header, table, checksums. Once as they are, and once as the blocks and the table of a file whose
//! header, footer and checksum of the table are right, or nothing would come past these.
#![no_main]

use std::path::Path;

use bytes::Bytes;
use libfuzzer_sys::fuzz_target;
use luxel::lxt::{Container, Transfer};

/// Bytes of a header, an entry of the table, a footer; blocks begin at multiples of it.
const UNIT: usize = 64;

fuzz_target!(|data: &[u8]| {
    read(data.to_vec());
    if let Some((&entries, body)) = data.split_first() {
        read(mended(body, entries as usize));
    }
});

fn read(file: Vec<u8>) {
    let Ok(file) = Container::of_bytes(Path::new("fuzz.lxt"), Bytes::from(file), Transfer::PURPOSE) else { return };
    let sound = file.names().filter(|&(kind, number)| file.block(kind, number).is_ok()).count();
    // Both ways of comparing blocks with their checksums agree.
    assert_eq!(file.verify().is_ok(), sound == file.names().count());
    let _ = Transfer::of(file);
}

/// A file whose last `entries` units before the footer are its table; see docs/LXT.md.
fn mended(body: &[u8], entries: usize) -> Vec<u8> {
    let mut file = b"\x89LXT\r\n\x1a\n\x01\0\0\0\0\0\0\0transfer".to_vec();
    file.resize(UNIT, 0);
    let header = file.clone();
    file.extend(body);
    file.resize(file.len().next_multiple_of(UNIT), 0);
    let entries = entries.min(file.len() / UNIT - 1);
    let table = file.len() - UNIT * entries;
    // Every other block gets its checksum too.
    let mut at = UNIT;
    for entry in (table..file.len()).step_by(2 * UNIT) {
        let length = u64::from_le_bytes(std::array::from_fn(|k| file[entry + 24 + k])) as usize;
        let Some(payload) = at.checked_add(length).and_then(|end| file.get(at..end)) else { break };
        let hash = blake3::hash(payload);
        file[entry + 32..entry + UNIT].copy_from_slice(hash.as_bytes());
        at = (at + length).next_multiple_of(UNIT);
        if entry + UNIT < file.len() {
            let next = u64::from_le_bytes(std::array::from_fn(|k| file[entry + UNIT + 24 + k])) as usize;
            let Some(end) = at.checked_add(next).and_then(|end| end.checked_next_multiple_of(UNIT)) else { break };
            at = end;
        }
    }
    let hash = blake3::Hasher::new().update(&header).update(&file[table..]).finalize();
    file.extend((table as u64).to_le_bytes());
    file.extend((entries as u64).to_le_bytes());
    file.extend(hash.as_bytes());
    file.extend([0; 8]);
    file.extend(b"\x89LXTend\n");
    file
}
