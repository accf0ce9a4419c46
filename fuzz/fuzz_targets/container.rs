//! Any bytes as a container: header, table, checksums.
#![no_main]

use std::path::Path;

use bytes::Bytes;
use libfuzzer_sys::fuzz_target;
use luxel::lxt::{Container, Transfer};

fuzz_target!(|data: &[u8]| {
    let bytes = Bytes::copy_from_slice(data);
    if let Ok(file) = Container::of_bytes(Path::new("fuzz.lxt"), bytes, Transfer::PURPOSE) {
        for (kind, number) in file.names() {
            let _ = file.block(kind, number);
        }
        let _ = file.verify();
    }
});
