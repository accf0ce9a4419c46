//! The container of transfer files: what is read is what was written, or an error that says what is wrong.

use std::path::Path;

use bytes::Bytes;
use luxel::{
    Error, Result,
    lxt::{Container, Name, Writer, write_file},
};
use proptest::prelude::*;

const PURPOSE: Name = Name::new("test");
const ROWS: Name = Name::new("rows");
const SCENE: Name = Name::new("scene");

type Change<'a> = &'a dyn Fn(&mut Vec<u8>);
type Blocks = Vec<(Name, u64, Vec<u8>)>;

fn written(blocks: &Blocks) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), PURPOSE).unwrap();
    for (kind, number, payload) in blocks {
        let (first, rest) = payload.split_at(payload.len() / 3);
        writer.block(*kind, *number, &[first, rest]).unwrap();
    }
    writer.finish().unwrap()
}

fn read(bytes: &[u8]) -> Result<Blocks> {
    let file = Container::of_bytes(Path::new("some.lxt"), Bytes::copy_from_slice(bytes), PURPOSE)?;
    let names = [SCENE, ROWS].into_iter().flat_map(|kind| file.numbers(kind).map(move |n| (kind, n)));
    names.map(|(kind, n)| Ok((kind, n, file.block(kind, n)?.to_vec()))).collect()
}

/// A scene, rows 0 and 7, and an empty block.
fn example() -> Blocks {
    let payload = |n: usize, k: u32| (0..n as u32).map(|i| (i.wrapping_mul(k) >> 3) as u8).collect();
    vec![(SCENE, 0, payload(200, 77)), (ROWS, 0, payload(64, 5)), (ROWS, 7, payload(130, 9)), (ROWS, 8, Vec::new())]
}

#[test]
fn blocks_come_back_as_they_were_written() {
    let blocks = example();
    assert_eq!(read(&written(&blocks)).unwrap(), blocks);
    assert_eq!(read(&written(&Vec::new())).unwrap(), Vec::new());
}

#[test]
fn blocks_of_a_mapped_file_lie_at_multiples_of_64_bytes_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/some.lxt");
    let blocks = example();
    let fill = |w: &mut Writer<&mut dyn std::io::Write>| {
        blocks.iter().try_for_each(|(kind, number, payload)| w.block(*kind, *number, &[payload]))
    };
    write_file(&path, PURPOSE, fill).unwrap();
    let file = Container::open(&path, PURPOSE).unwrap();
    file.verify().unwrap();
    for (kind, number, payload) in &blocks {
        let block = file.block(*kind, *number).unwrap();
        assert_eq!(&*block, &payload[..]);
        assert!(block.is_empty() || (block.as_ptr() as usize).is_multiple_of(64));
        // Not copied: asked again, it is the same memory.
        assert_eq!(block.as_ptr(), file.block(*kind, *number).unwrap().as_ptr());
    }
}

#[test]
fn every_single_bit_of_a_file_counts_but_those_of_the_padding() {
    let blocks = example();
    let bytes = written(&blocks);
    let mut padding = 0;
    for bit in 0..bytes.len() * 8 {
        let mut changed = bytes.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        match read(&changed) {
            Err(Error::Input { .. }) => (),
            Err(other) => panic!("bit {bit}: {other}"),
            // 200, 64 and 130 bytes to the next 64.
            Ok(same) => {
                assert_eq!(same, blocks, "bit {bit}");
                padding += 1;
            }
        }
    }
    assert_eq!(padding, 8 * (56 + 62));
}

#[test]
fn a_file_that_is_cut_off_anywhere_is_refused() {
    let bytes = written(&example());
    for length in 0..bytes.len() {
        let message = read(&bytes[..length]).unwrap_err().to_string();
        let expected = if length < 64 { "is no file of luxel's own" } else { "is cut off or damaged at its end" };
        assert!(message.contains(expected), "{length}: {message}");
    }
}

#[test]
fn what_is_wrong_is_named_with_a_remedy() {
    let bytes = written(&example());
    let message = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = bytes.clone();
        change(&mut bytes);
        read(&bytes).unwrap_err().to_string()
    };
    // The payload of rows 7 begins behind 64 of the header, 256 of the scene, 64 of rows 0.
    let cases: [(&str, Change); 8] = [
        ("some.lxt: block rows 7: its 130 bytes are not what was written: copy it again, or make it anew", &|b| {
            b[64 + 256 + 64 + 129] ^= 1
        }),
        ("is no file of luxel's own", &|b| *b = b"#!/bin/sh\n".repeat(50)),
        ("is no file of luxel's own", &|b| b.clear()),
        ("has format 2, but this luxel reads format 1: use the luxel that wrote it, or make it anew", &|b| b[8] = 2),
        ("table of blocks: is damaged", &|b| {
            let n = b.len();
            b[n - 65] ^= 1
        }),
        ("is cut off or damaged at its end, byte 960", &|b| b.extend([1; 64])),
        ("table of blocks: is damaged", &|b| {
            // The footer is hostile: more blocks than numbers have room for.
            let n = b.len();
            b[n - 56..n - 48].fill(255);
        }),
        ("table of blocks: is damaged", &|b| {
            let n = b.len();
            b[n - 64..n - 56].fill(255);
        }),
    ];
    for (expected, change) in cases {
        let message = message(change);
        assert!(message.contains(expected), "{message}\n(expected: {expected})");
    }
    let other = Container::of_bytes(Path::new("x"), bytes.clone().into(), Name::new("shard")).err().unwrap();
    assert_eq!(other.to_string(), "x: is a test file, but a shard file is needed here");
    let file = Container::of_bytes(Path::new("x"), bytes.into(), PURPOSE).unwrap();
    assert!(file.block(ROWS, 3).unwrap_err().to_string().starts_with("x: block rows 3: is missing: "));
    assert!(
        Container::open(Path::new("/nowhere/at/all"), PURPOSE).err().unwrap().to_string().contains("/nowhere/at/all: ")
    );
}

#[test]
fn a_table_of_hostile_lengths_with_a_fitting_checksum_is_refused() {
    let blocks = example();
    for (entry, length) in (0..4).flat_map(|e| [u64::MAX, u64::MAX - 63, 1 << 40, 63, 0].map(|length| (e, length))) {
        let mut bytes = written(&blocks);
        let table = bytes.len() - 64 - 4 * 64;
        let at = table + entry * 64 + 24;
        if bytes[at..at + 8] == length.to_le_bytes() {
            continue;
        }
        bytes[at..at + 8].copy_from_slice(&length.to_le_bytes());
        let end = bytes.len() - 64;
        let hash = blake3::Hasher::new().update(&bytes[..64]).update(&bytes[table..end]).finalize();
        bytes[end + 16..end + 48].copy_from_slice(hash.as_bytes());
        assert!(matches!(read(&bytes), Err(Error::Input { .. })), "entry {entry}, length {length}");
    }
}

#[test]
fn two_blocks_of_one_name_are_refused() {
    let twice = vec![(ROWS, 1, vec![1]), (ROWS, 1, vec![2])];
    assert!(matches!(read(&written(&twice)), Err(Error::Input { .. })));
}

proptest! {
    #[test]
    fn spliced_files_are_refused_or_the_same(from in 0usize..1024, to in 0usize..1024, length in 1usize..200) {
        let blocks = example();
        let mut bytes = written(&blocks);
        let n = bytes.len();
        let (from, to) = (from % n, to % n);
        let length = length.min(n - from.max(to));
        bytes.copy_within(from..from + length, to);
        match read(&bytes) {
            Ok(same) => prop_assert_eq!(same, blocks),
            Err(e) => prop_assert!(matches!(e, Error::Input { .. }), "{}", e),
        }
    }
}
