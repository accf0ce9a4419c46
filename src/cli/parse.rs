//! Values of the command line, with messages that say what would be right.

use std::{path::PathBuf, str::FromStr, time::Duration};

use clap::builder::{PathBufValueParser, TypedValueParser};
use glam::{DVec3, Vec3};

type Parsed<T> = Result<T, String>;

/// A finite number.
pub fn number(text: &str) -> Parsed<f64> {
    match text.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        Ok(_) => Err(format!("{} is not finite", text.trim())),
        Err(_) => Err(format!("{:?} is not a number", text.trim())),
    }
}

/// A number above zero.
pub fn positive(text: &str) -> Parsed<f64> {
    let x = number(text)?;
    if x > 0.0 { Ok(x) } else { Err("must be above 0".into()) }
}

/// A share above zero: `2%`, or `0.02`.
pub fn share(text: &str) -> Parsed<f64> {
    match text.trim().strip_suffix('%') {
        Some(percent) => Ok(positive(percent)? / 100.0),
        None => match positive(text)? {
            x if x < 1.0 => Ok(x),
            x => Err(format!("{x} of the whole is more than all; was {x}% meant?")),
        },
    }
}

/// Paths a point.
pub fn paths(text: &str) -> Parsed<u32> {
    whole(text, 2, 1 << 30)
}

/// A number above zero that single precision holds.
pub fn positive_f32(text: &str) -> Parsed<f32> {
    let x = positive(text)? as f32;
    if x > 0.0 && x.is_finite() { Ok(x) } else { Err("is out of the range of single precision".into()) }
}

/// An angle between normals, degrees.
pub fn threshold(text: &str) -> Parsed<f32> {
    let x = number(text)? as f32;
    if x > 0.0 && x < 90.0 { Ok(x) } else { Err("must be above 0 and below 90 degrees".into()) }
}

/// A vertical angle of view, degrees.
pub fn view_angle(text: &str) -> Parsed<f64> {
    let x = number(text)?;
    if (1.0..=170.0).contains(&x) { Ok(x) } else { Err("must be from 1 to 170 degrees".into()) }
}

/// A share, `0.5%` or `0.5`, above zero; 100 % is 1.
pub fn percent(text: &str) -> Parsed<f64> {
    Ok(positive(text.trim().trim_end_matches('%'))? / 100.0)
}

/// A time above zero: `30s`, `5m`, `1.5h`.
pub fn time(text: &str) -> Parsed<Duration> {
    let text = text.trim();
    let units = [("s", 1.0), ("m", 60.0), ("h", 3600.0)];
    let (value, unit) = units
        .into_iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)))
        .filter(|(value, _)| !value.ends_with(char::is_alphabetic))
        .ok_or("expected a time with its unit, such as 30s, 5m or 1h")?;
    Duration::try_from_secs_f64(positive(value)? * unit).map_err(|_| "is too long".into())
}

/// Bytes above zero: `900M`, `4G`, `1.5T`; decimal units.
pub fn memory(text: &str) -> Parsed<u64> {
    let text = text.trim().trim_end_matches(['B', 'b']);
    let units = [('k', 1e3), ('M', 1e6), ('G', 1e9), ('T', 1e12)];
    let (value, unit) = units
        .into_iter()
        .find_map(|(name, unit)| {
            Some((text.strip_suffix([name, name.to_ascii_lowercase(), name.to_ascii_uppercase()])?, unit))
        })
        .ok_or("expected a size with its unit, such as 900M or 4G")?;
    let bytes = positive(value)? * unit;
    if bytes < 1e18 { Ok(bytes as u64) } else { Err("is too large".into()) }
}

/// A folder that is there.
pub fn folder() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| if path.is_dir() { Ok(path) } else { Err("there is no such folder") })
}

/// Voxels on the longest side.
pub fn grid(text: &str) -> Parsed<u32> {
    whole(text, 2, 4096)
}

/// Rays a patch.
pub fn rays(text: &str) -> Parsed<u32> {
    let rays: u32 = whole(text, 16, 65536)?;
    if rays.is_power_of_two() {
        Ok(rays)
    } else {
        let below = 1 << rays.ilog2();
        Err(format!("must be a power of two, such as {below} or {}", 2 * below))
    }
}

/// Patches of a simplified mesh.
pub fn target_patches(text: &str) -> Parsed<u32> {
    whole(text, 16, 50_000_000)
}

/// Rays of a point that gathers.
pub fn gather_rays(text: &str) -> Parsed<u32> {
    whole(text, 16, 65536)
}

/// Shadow rays a point.
pub fn samples(text: &str) -> Parsed<u32> {
    whole(text, 1, 65536)
}

/// How many.
pub fn count(text: &str) -> Parsed<usize> {
    whole(text, 1, 100_000_000)
}

/// Threads of a pool.
pub fn threads(text: &str) -> Parsed<usize> {
    whole(text, 1, 4096)
}

/// Width and height of a picture, `640x480`.
pub fn size(text: &str) -> Parsed<(u32, u32)> {
    let (width, height) = text.split_once(['x', 'X']).ok_or("expected WIDTHxHEIGHT, such as 640x480")?;
    Ok((whole(width, 1, 16384)?, whole(height, 1, 16384)?))
}

/// `R,G,B`, none below zero.
pub fn colour(text: &str) -> Parsed<Vec3> {
    let rgb = triple(text, "R,G,B")?.as_vec3();
    if !rgb.is_finite() {
        Err("is out of the range of single precision".into())
    } else if rgb.min_element() < 0.0 {
        Err("light cannot be negative".into())
    } else {
        Ok(rgb)
    }
}

/// `X,Y,Z`, not all zero.
pub fn direction(text: &str) -> Parsed<DVec3> {
    let d = triple(text, "X,Y,Z")?;
    if d == DVec3::ZERO { Err("a direction cannot be 0,0,0".into()) } else { Ok(d) }
}

/// `X,Y,Z`, a position.
pub fn place(text: &str) -> Parsed<DVec3> {
    triple(text, "X,Y,Z")
}

/// `X,Y,Z:R,G,B`, a direction with a colour.
pub fn sun(text: &str) -> Parsed<(DVec3, Vec3)> {
    let (d, rgb) = halves(text, ':', "X,Y,Z:R,G,B")?;
    Ok((direction(d)?, colour(rgb)?))
}

/// `X,Y,Z:R,G,B`, a position with a colour.
pub fn point(text: &str) -> Parsed<(DVec3, Vec3)> {
    let (p, rgb) = halves(text, ':', "X,Y,Z:R,G,B")?;
    Ok((triple(p, "X,Y,Z")?, colour(rgb)?))
}

/// `MATERIAL=R,G,B`; the name may itself hold a `=`.
pub fn emit(text: &str) -> Parsed<(String, Vec3)> {
    let (name, rgb) = text.rsplit_once('=').ok_or("expected MATERIAL=R,G,B")?;
    if name.is_empty() { Err("expected MATERIAL=R,G,B".into()) } else { Ok((name.into(), colour(rgb)?)) }
}

/// `X,Y,Z:X,Y,Z`, two different positions.
pub fn view(text: &str) -> Parsed<(DVec3, DVec3)> {
    let (from, to) = halves(text, ':', "X,Y,Z:X,Y,Z")?;
    let (from, to) = (triple(from, "X,Y,Z")?, triple(to, "X,Y,Z")?);
    if from == to { Err("a camera cannot look at its own position".into()) } else { Ok((from, to)) }
}

fn halves<'a>(text: &'a str, by: char, form: &str) -> Parsed<(&'a str, &'a str)> {
    text.split_once(by).ok_or_else(|| format!("expected {form}"))
}

fn triple(text: &str, form: &str) -> Parsed<DVec3> {
    let numbers = text.split(',').map(number).collect::<Parsed<Vec<f64>>>()?;
    let three: [f64; 3] =
        numbers.try_into().map_err(|v: Vec<f64>| format!("expected {form}, three numbers, not {}", v.len()))?;
    Ok(three.into())
}

/// A number that counts from 0.
pub fn index(text: &str) -> Parsed<usize> {
    text.trim().parse().map_err(|_| "must be a whole number, 0 or more".into())
}

fn whole<T: FromStr + PartialOrd + std::fmt::Display>(text: &str, least: T, most: T) -> Parsed<T> {
    match text.trim().parse::<T>() {
        Ok(n) if n >= least && n <= most => Ok(n),
        _ => Err(format!("must be a whole number from {least} to {most}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_read_with_negative_numbers_and_blanks() {
        assert_eq!(sun("-1,-2.5,0:1,2,3e1"), Ok((DVec3::new(-1.0, -2.5, 0.0), Vec3::new(1.0, 2.0, 30.0))));
        assert_eq!(point("0, -1, 2 : 1, 1, 1"), Ok((DVec3::new(0.0, -1.0, 2.0), Vec3::ONE)));
        assert_eq!(emit("lamp=a=1,2,3"), Ok(("lamp=a".into(), Vec3::new(1.0, 2.0, 3.0))));
    }

    #[test]
    fn shares_and_times_have_units() {
        assert_eq!([percent("2%"), percent(" 0.5 % "), percent("100")], [Ok(0.02), Ok(0.005), Ok(1.0)]);
        let seconds = |text| time(text).map(|t| t.as_secs_f64());
        assert_eq!([seconds("30s"), seconds("5m"), seconds("1.5h")], [Ok(30.0), Ok(300.0), Ok(5400.0)]);
    }

    #[test]
    fn sizes_have_units() {
        assert_eq!(
            [memory("900M"), memory("4g"), memory(" 1.5 GB ")],
            [Ok(900_000_000), Ok(4_000_000_000), Ok(1_500_000_000)]
        );
        for wrong in ["4", "G", "-1G", "1e12G"] {
            assert!(memory(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn wrong_values_are_told_what_would_be_right() {
        let message = |r: Parsed<()>| r.unwrap_err();
        assert_eq!(message(rays("100").map(drop)), "must be a power of two, such as 64 or 128");
        assert_eq!(message(rays("8").map(drop)), "must be a whole number from 16 to 65536");
        assert_eq!(message(grid("1").map(drop)), "must be a whole number from 2 to 4096");
        assert_eq!(message(colour("1,2").map(drop)), "expected R,G,B, three numbers, not 2");
        assert_eq!(message(colour("1,nan,2").map(drop)), "nan is not finite");
        assert_eq!(message(colour("1,-1,2").map(drop)), "light cannot be negative");
        assert_eq!(message(colour("1e39,0,0").map(drop)), "is out of the range of single precision");
        assert_eq!(message(sun("0,0,0:1,1,1").map(drop)), "a direction cannot be 0,0,0");
        assert_eq!(message(sun("0,1,0").map(drop)), "expected X,Y,Z:R,G,B");
        assert_eq!(message(emit("1,1,1").map(drop)), "expected MATERIAL=R,G,B");
        assert_eq!(message(positive("-0").map(drop)), "must be above 0");
        assert_eq!(message(size("640").map(drop)), "expected WIDTHxHEIGHT, such as 640x480");
        assert_eq!(message(number("1,5").map(drop)), "\"1,5\" is not a number");
        assert_eq!(message(percent("0%").map(drop)), "must be above 0");
        assert_eq!(message(percent("one").map(drop)), "\"one\" is not a number");
        assert_eq!(message(time("30").map(drop)), "expected a time with its unit, such as 30s, 5m or 1h");
        assert_eq!(message(time("1ms").map(drop)), "expected a time with its unit, such as 30s, 5m or 1h");
        assert_eq!(message(time("-1s").map(drop)), "must be above 0");
        assert_eq!(message(time("1e99h").map(drop)), "is too long");
        assert_eq!(message(threshold("90").map(drop)), "must be above 0 and below 90 degrees");
    }
}
