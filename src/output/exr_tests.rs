use super::*;

const ALL: [Compression; 5] =
    [Compression::Zip, Compression::Zips, Compression::Rle, Compression::Piz, Compression::None];

type Write = fn(&Path, &ExrImage, Compression) -> Result<()>;
type Read = fn(&Path) -> Result<ExrImage>;

#[cfg(feature = "openexr")]
fn native_read(path: &Path) -> Result<ExrImage> {
    Ok(native::read(path)?.expect("the native reader reads scanline files"))
}

#[cfg(feature = "openexr")]
const WRITERS: [Write; 2] = [native::write, pure::write];
#[cfg(feature = "openexr")]
const READERS: [Read; 2] = [native_read, pure::read];
#[cfg(not(feature = "openexr"))]
const WRITERS: [Write; 1] = [pure::write];
#[cfg(not(feature = "openexr"))]
const READERS: [Read; 1] = [pure::read];

/// 37 rows, so that the last block of 16 or 32 is not full.
fn picture() -> ExrImage {
    let (width, height) = (53, 37);
    let values = |f: fn(f32) -> f32| (0..width * height).map(|i| f(i as f32)).collect::<Vec<f32>>();
    let channel = |name: &str, half, values| ExrChannel { name: name.into(), half, values };
    ExrImage {
        width,
        height,
        channels: vec![
            channel("direct.R", false, values(|i| (i * 0.37).sin() * 1e6)),
            channel("R", true, values(|i| i / 7.0)),
            channel("G", false, values(|i| if i == 5.0 { f32::INFINITY } else { i * 1e-30 })),
            channel("a much longer name than the thirty-one bytes of old.Z", false, values(|i| -i)),
        ],
        attributes: vec![
            ("luxel.certificate".into(), ExrAttribute::Text("{\"error\": 0.01, \"wo\": \"Gl\u{e4}tte\"}".into())),
            ("luxel.seconds".into(), ExrAttribute::Float(1.25)),
            ("comments".into(), ExrAttribute::Text("two\nlines".into())),
            ("isoSpeed".into(), ExrAttribute::Float(100.0)),
            ("empty".into(), ExrAttribute::Text(String::new())),
        ],
    }
}

/// What is read back: sorted, and half channels rounded.
fn expected() -> ExrImage {
    let mut image = sorted(picture());
    for channel in image.channels.iter_mut().filter(|c| c.half) {
        channel.values.iter_mut().for_each(|x| *x = ::exr::prelude::f16::from_f32(*x).to_f32());
    }
    image
}

#[test]
fn every_reader_reads_what_every_writer_wrote() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.exr");
    for compression in ALL {
        for (w, writer) in WRITERS.into_iter().enumerate() {
            write_with(&path, &picture(), compression, writer).unwrap();
            for (r, reader) in READERS.into_iter().enumerate() {
                let image = sorted(reader(&path).unwrap());
                assert_eq!(image, expected(), "{compression:?}, writer {w}, reader {r}");
            }
        }
    }
}

#[test]
fn half_floats_are_the_nearest_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.exr");
    // Ties go to even; below 2^-25 there is only zero, above 65520 only infinity.
    let values = vec![1.0 + 1.0 / 2048.0, 1.0 + 3.0 / 2048.0, 2f32.powi(-24), 2f32.powi(-26), 65504.0, 1e6];
    let nearest = vec![1.0, 1.0 + 4.0 / 2048.0, 2f32.powi(-24), 0.0, 65504.0, f32::INFINITY];
    let channel = ExrChannel { name: "Y".into(), half: true, values };
    let image = ExrImage { width: 3, height: 2, channels: vec![channel], attributes: vec![] };
    for writer in WRITERS {
        write_with(&path, &image, Compression::Zip, writer).unwrap();
        for reader in READERS {
            let read = reader(&path).unwrap();
            assert!(read.channels[0].half);
            assert_eq!(read.channels[0].values, nearest);
        }
    }
}

#[test]
fn a_tiled_file_is_read_whichever_library_is_there() {
    use ::exr::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tiled.exr");
    let values: Vec<f32> = (0..70 * 50).map(|i| i as f32).collect();
    let channels = AnyChannels::sort([AnyChannel::new("Y", FlatSamples::F32(values.clone()))].into_iter().collect());
    let encoding = Encoding { blocks: Blocks::Tiles(Vec2(16, 16)), ..Encoding::SMALL_LOSSLESS };
    Image::from_layer(Layer::new((70, 50), LayerAttributes::default(), encoding, channels))
        .write()
        .to_file(&path)
        .unwrap();
    let image = super::read(&path).unwrap();
    assert_eq!((image.width, image.height), (70, 50));
    assert_eq!(image.channels[0].values, values);
}

#[test]
fn the_same_image_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.exr");
    for write in WRITERS {
        let bytes = [0; 8].map(|_| {
            write_with(&path, &picture(), Compression::Zip, write).unwrap();
            fs::read(&path).unwrap()
        });
        assert!(bytes.iter().all(|b| *b == bytes[0]));
    }
}

#[test]
fn a_failed_write_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.exr");
    let fails: Write = |path, _, _| {
        fs::write(path, "half a file").unwrap();
        Err(Error::Backend("disk full".into()))
    };
    assert!(write_with(&path, &picture(), Compression::Zip, fails).is_err());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    assert!(write(&folder.path().join("absent/picture.exr"), &picture(), Compression::Zip).is_err());
    // A folder stands where the file should go: the rename fails.
    fs::create_dir(&path).unwrap();
    fs::write(path.join("file"), "").unwrap();
    assert!(write(&path, &picture(), Compression::Zip).is_err());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn images_that_make_no_sense_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.exr");
    let spoilt: [fn(&mut ExrImage); 7] = [
        |i| i.width = 0,
        |i| i.height = 38,
        |i| i.channels.clear(),
        |i| i.channels[1].name = "G".into(),
        |i| i.channels[1].name.clear(),
        |i| i.attributes[1].0 = "comments".into(),
        |i| i.attributes[0].1 = ExrAttribute::Text("a\0b".into()),
    ];
    for (k, spoil) in spoilt.into_iter().enumerate() {
        let mut image = picture();
        spoil(&mut image);
        assert!(matches!(write(&path, &image, Compression::Zip), Err(Error::Option(_))), "{k}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn files_that_are_no_images_are_errors_that_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("garbage.exr");
    assert!(matches!(read(&path), Err(Error::Io { .. })));
    for bytes in [&b""[..], b"v/1", b"hello, this is text", b"\x76\x2f\x31\x01\x02\0\0\0\0"] {
        fs::write(&path, bytes).unwrap();
        let error = read(&path).unwrap_err();
        assert!(error.to_string().contains("garbage.exr"), "{error}");
    }
}

#[test]
fn a_file_cut_short_anywhere_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, cut) = (folder.path().join("whole.exr"), folder.path().join("cut.exr"));
    write(&whole, &picture(), Compression::Zip).unwrap();
    let bytes = fs::read(&whole).unwrap();
    for k in 0..40 {
        fs::write(&cut, &bytes[..bytes.len() * k / 40]).unwrap();
        for reader in [read, pure::read] {
            assert!(reader(&cut).is_err(), "{k}/40");
        }
    }
}

#[test]
fn a_header_that_promises_too_much_is_refused_before_memory_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.exr");
    for writer in WRITERS {
        write_with(&path, &picture(), Compression::Zip, writer).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        // dataWindow: name, type box2i, size 16, then min x, min y, max x, max y.
        let start = bytes.windows(11).position(|w| w == b"dataWindow\0").unwrap() + 11 + 6 + 4;
        bytes[start + 8..start + 12].copy_from_slice(&500_000i32.to_le_bytes());
        bytes[start + 12..start + 16].copy_from_slice(&500_000i32.to_le_bytes());
        fs::write(&path, &bytes).unwrap();
        for reader in [read, pure::read] {
            assert!(matches!(reader(&path), Err(Error::Input { .. })));
        }
    }
}

#[test]
fn damaged_bytes_never_crash_a_reader() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, damaged) = (folder.path().join("whole.exr"), folder.path().join("damaged.exr"));
    write(&whole, &picture(), Compression::Zip).unwrap();
    let bytes = fs::read(&whole).unwrap();
    let mut state = 1u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % n
    };
    for _ in 0..300 {
        let mut bytes = bytes.clone();
        for _ in 0..=random(3) {
            // The header is where the danger is.
            let end = if random(2) == 0 { 700 } else { bytes.len() };
            let at = random(end);
            bytes[at] = random(256) as u8;
        }
        fs::write(&damaged, &bytes).unwrap();
        for reader in [read, pure::read] {
            // Pixels may have changed unnoticed; the shape may not.
            if let Ok(image) = reader(&damaged) {
                let pixels = image.width as usize * image.height as usize;
                assert!(image.channels.iter().all(|c| c.values.len() == pixels));
            }
        }
    }
}

#[test]
fn the_library_says_its_name_and_version() {
    let expected = if cfg!(feature = "openexr") { "OpenEXRCore 3." } else { "exr 1." };
    assert!(library().starts_with(expected), "{}", library());
    assert!(pure::library().starts_with("exr "));
}
