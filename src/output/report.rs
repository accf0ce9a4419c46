//! `bake.json` and what a terminal shows of it.

use std::{
    fmt::Write as _,
    io::{self, Write},
};

use serde::Serialize;

use crate::{
    Scene,
    report::{Energy, ErrorPeak, ErrorReport, GoalReport, Report, RowCounts},
    scene::Camera,
};

/// The content of `bake.json`; docs/BAKE_JSON.md describes every field.
#[derive(Serialize)]
pub struct Record<'a> {
    /// The command line.
    pub command: &'a [String],
    /// Name of the scene.
    pub scene: &'a str,
    /// What the bake measured.
    #[serde(flatten)]
    pub report: &'a Report,
    /// How the pictures were made; `None` without pictures.
    pub preview: Option<PreviewRecord>,
}

/// How the pictures were made.
#[derive(Serialize)]
pub struct PreviewRecord {
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Factor on radiance before the tone curve.
    pub exposure: f32,
    /// World position of the eye.
    pub position: [f64; 3],
    /// World position that it looks at.
    pub target: [f64; 3],
    /// Which way is up.
    pub up: [f64; 3],
    /// Vertical angle of view, degrees.
    pub vertical_fov: f64,
}

impl PreviewRecord {
    /// Of a picture of `width` x `height` pixels from `camera`.
    pub fn new(camera: &Camera, (width, height): (u32, u32), exposure: f32) -> PreviewRecord {
        PreviewRecord {
            width,
            height,
            exposure,
            position: camera.position.to_array(),
            target: camera.target.to_array(),
            up: camera.up.to_array(),
            vertical_fov: camera.vertical_fov,
        }
    }
}

impl Record<'_> {
    /// Writes indented JSON. Numbers that are not finite become `null`.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        serde_json::to_writer_pretty(&mut *out, self)?;
        writeln!(out)
    }
}

/// A few lines for the reader of a terminal.
pub fn summary(scene: &Scene, report: &Report) -> String {
    let (c, r) = (&report.counts, &report.rays);
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a String cannot fail.
        writeln!(text, "{name:<14}{value}").ok();
    };
    line("scene", format!("{}: {} triangles", scene.name, c.triangles));
    line("backend", format!("{}, {} threads", report.backend, report.threads));
    line(
        "patches",
        format!("{} of which light reaches {}; voxel {}", c.patches, c.patches_reached, short(c.voxel_size)),
    );
    line("vertices", c.vertices.to_string());
    let rays = match r.form_factors {
        0 => "no ray traced".into(),
        rays => format!("{rays} rays at {} Mrays/s", short(r.form_factor_mrays_per_second)),
    };
    line("form factors", format!("{} in {}; {rays}", c.form_factors, bytes(c.form_factor_bytes as u64)));
    let RowCounts { used, cast, from, kept_in, .. } = &report.rows;
    match (from, kept_in) {
        (Some(from), None) if *cast == 0 => line("rows", format!("{used} used, all from {from}")),
        (Some(from), None) => line("rows", format!("{used} used; {cast} cast now, the others from {from}")),
        (Some(_), Some(place)) => {
            line("rows", format!("{used} used; {cast} cast now and kept in {place}, the others from there"));
        }
        (None, Some(place)) => line("rows", format!("{used} used, all cast now and kept in {place}")),
        (None, None) => {}
    }
    line("other rays", r.visibility.to_string());
    let is_short = report.settings.as_ref().is_some_and(|s| report.solver.residual > s.tolerance);
    line(
        "solver",
        format!(
            "{}, {} iterations, residual {}{}",
            report.solver.method,
            report.solver.iterations,
            short(report.solver.residual),
            if is_short { ", which is as far as it got: more than --tolerance asks for" } else { "" }
        ),
    );
    line("power", energy(&report.energy));
    if let Some(e) = &report.error {
        line("error", error(e));
        if let Some(peak) = &e.peak {
            line("", place(e, peak));
        }
    }
    if let Some(g) = &report.goal {
        line("goal", goal(g, report.error.as_ref()));
    }
    let stages: Vec<String> = report.stages.iter().map(|s| format!("{} {:.2}", s.name, s.seconds)).collect();
    let total: f64 = report.stages.iter().map(|s| s.seconds).sum();
    line("seconds", format!("{total:.2}: {}", stages.join(", ")));
    if report.peak_memory_bytes > 0 {
        let foretold = report.foretold_memory_bytes.map_or(String::new(), |foretold| {
            format!(", with pages of files; {} foretold, without form factors in a file", bytes(foretold))
        });
        line("peak memory", bytes(report.peak_memory_bytes) + &foretold);
    }
    if !report.skipped.is_empty() {
        line("skipped", format!("{:<37}{:>9}{:>12}{:>9}{:>10}", "", "patches", "rays", "seconds", "error"));
    }
    for s in &report.skipped {
        let seconds = s.seconds.map_or("-".into(), |seconds| format!("{seconds:.2}"));
        let bound = s.bound.map_or("-".into(), |b| if b == 0.0 { "0".into() } else { format!("{b:.1e}") });
        line("", format!("{:<37}{:>9}{:>12}{seconds:>9}{bound:>10}", s.what, s.patches, s.rays));
    }
    for warning in &report.warnings {
        line("warning", warning.clone());
    }
    text
}

fn goal(g: &GoalReport, e: Option<&ErrorReport>) -> String {
    let (verdict, why) = match g.reached {
        Some(true) => ("target reached: ", String::new()),
        Some(false) => ("target not reached: ", format!("; {}", g.ended)),
        None => ("", format!("; {}", g.ended)),
    };
    let estimated = 100.0 * e.map_or(f64::NAN, |e| e.total.total);
    format!("{verdict}estimated {estimated:.2} % after {} bakes in {:.2} s{why}", g.steps.len(), g.seconds)
}

fn error(e: &ErrorReport) -> String {
    let percent = |x: f64| format!("{:.2} %", 100.0 * x);
    format!(
        "total {} (direct {}, indirect {}: noise {}, grid {})",
        percent(e.total.total),
        percent(e.direct.total),
        percent(e.indirect.total),
        percent(e.indirect.noise),
        percent(e.indirect.discretisation)
    )
}

/// Where most of the error is, what is left elsewhere, and what helps.
fn place(e: &ErrorReport, peak: &ErrorPeak) -> String {
    let elsewhere = e.total.total * ((1.0 - peak.squares) / (1.0 - peak.area)).sqrt();
    let remedy = match peak.mostly {
        "shadow_noise" => "more --point-samples help there",
        "row_noise" => "more --rays or --reconstruct adaptive help there",
        _ => "--reconstruct adaptive or a finer --grid helps there",
    };
    let [x, y, z] = peak.position.map(short);
    format!(
        "of its squares {:.0} % lie on {:.1} % of the area, within about {} of ({x}, {y}, {z}): {remedy}; elsewhere it is {:.2} %",
        100.0 * peak.squares,
        100.0 * peak.area,
        short(peak.radius),
        100.0 * elsewhere
    )
}

fn energy(e: &Energy) -> String {
    let sum = |rgb: [f64; 3]| short(rgb.iter().sum());
    let worst = e.imbalance.iter().fold(0.0, |w: f64, x| if x.abs() > w.abs() { *x } else { w });
    let (direct, absorbed, escaped) = (sum(e.direct), sum(e.absorbed), sum(e.escaped));
    format!("direct {direct} W, absorbed {absorbed} W, escaped {escaped} W, imbalance {:.2} %", 100.0 * worst)
}

/// Four significant digits, with an exponent for what is very large or small.
fn short(x: f64) -> String {
    if x != 0.0 && !(1e-3..1e7).contains(&x.abs()) {
        return format!("{x:.3e}");
    }
    let before = if x == 0.0 { 1 } else { x.abs().log10().floor() as i32 + 1 };
    format!("{x:.*}", (4 - before).clamp(0, 6) as usize)
}

/// A number of bytes for people to read: `1.5 kB`.
pub fn bytes(n: u64) -> String {
    match n {
        0..1_000 => format!("{n} B"),
        1_000..1_000_000 => format!("{:.1} kB", n as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", n as f64 / 1e6),
        _ => format!("{:.2} GB", n as f64 / 1e9),
    }
}

/// Largest resident memory of this process so far, bytes; 0 where the system does not tell (`/proc/self/status`).
pub fn peak_memory_bytes() -> u64 {
    status_bytes("VmHWM:")
}

/// Resident memory of this process now, bytes; 0 where the system does not tell.
pub fn memory_bytes() -> u64 {
    status_bytes("VmRSS:")
}

/// What of it is pages of files, code among them; 0 where the system does not tell.
pub fn mapped_bytes() -> u64 {
    status_bytes("RssFile:")
}

fn status_bytes(field: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kib = status.lines().find_map(|l| l.strip_prefix(field)?.trim().strip_suffix("kB")?.trim().parse().ok());
    kib.map_or(0, |kib: u64| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        BakeOptions,
        report::{GoalStep, Stage},
    };

    #[test]
    fn the_record_is_flat_json_with_the_command() {
        let report = Report {
            version: "9.9".into(),
            settings: Some(BakeOptions::default()),
            stages: vec![Stage { name: "solve", seconds: 0.5 }],
            energy: Energy { imbalance: [f64::NAN, 0.0, 0.0], ..Default::default() },
            ..Default::default()
        };
        let command = ["luxel".to_string(), "bake".into()];
        let mut file = Vec::new();
        Record { command: &command, scene: "box", report: &report, preview: None }.write(&mut file).unwrap();
        let json: serde_json::Value = serde_json::from_slice(&file).unwrap();
        assert_eq!(json["command"][1], "bake");
        assert_eq!((&json["version"], &json["scene"]), (&"9.9".into(), &"box".into()));
        assert_eq!(json["settings"]["resolution"]["grid"], 64);
        assert_eq!(json["stages"][0]["seconds"], 0.5);
        assert!(json["energy"]["imbalance"][0].is_null() && json["preview"].is_null());
    }

    #[test]
    fn every_field_of_the_record_is_documented() {
        let settings = Some(BakeOptions::default());
        let error = Some(ErrorReport { peak: Some(ErrorPeak::default()), ..Default::default() });
        let report = Report { settings, error, ..Default::default() };
        let goal = Some(GoalReport { steps: vec![GoalStep::default()], ..Default::default() });
        let report = Report { goal, ..report };
        let camera = Camera {
            position: Default::default(),
            target: Default::default(),
            up: Default::default(),
            vertical_fov: 40.0,
        };
        let preview = Some(PreviewRecord::new(&camera, (1, 1), 1.0));
        let json = serde_json::to_value(Record { command: &[], scene: "", report: &report, preview }).unwrap();
        let page = include_str!("../../docs/BAKE_JSON.md");
        let mut left = vec![&json];
        while let Some(value) = left.pop() {
            left.extend(value.as_array().into_iter().flatten());
            for (key, inner) in value.as_object().into_iter().flatten() {
                assert!(page.contains(&format!("`{key}`")), "docs/BAKE_JSON.md lacks `{key}`");
                left.push(inner);
            }
        }
    }

    #[test]
    fn an_error_that_few_places_carry_is_told_with_its_place_and_the_remedy() {
        let peak = ErrorPeak {
            position: [278.0, 548.0, 279.5],
            radius: 80.0,
            squares: 0.96,
            area: 0.01,
            mostly: "discretisation",
            ..Default::default()
        };
        let mut error = ErrorReport { peak: Some(peak), ..Default::default() };
        error.total.total = 0.5;
        // 4 % of the squares on 99 % of the area.
        assert_eq!(
            place(&error, &peak),
            "of its squares 96 % lie on 1.0 % of the area, within about 80.00 of (278.0, 548.0, 279.5): --reconstruct \
             adaptive or a finer --grid helps there; elsewhere it is 10.05 %"
        );
        assert!(place(&error, &ErrorPeak { mostly: "row_noise", ..peak }).contains("--rays"));
        assert!(place(&error, &ErrorPeak { mostly: "shadow_noise", ..peak }).contains("--point-samples"));
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 0.0123456, 1.0, 12.3456, 123456.7, 1e9, -1e-5].map(short);
        assert_eq!(shown, ["0.000", "0.01235", "1.000", "12.35", "123457", "1.000e9", "-1.000e-5"]);
        assert_eq!([bytes(999), bytes(1_500), bytes(2_000_000_000)], ["999 B", "1.5 kB", "2.00 GB"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn memory_that_was_used_counts() {
        let block = std::hint::black_box(vec![1u8; 50_000_000]);
        assert!(peak_memory_bytes() > block.len() as u64);
    }
}
