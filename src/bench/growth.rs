//! Time and memory against the number of patches as an SVG picture, log-log.

use plotters::prelude::*;

use super::{
    Machine,
    plot::{Anchor, Area, Axis, COLOURS, Drawn, INK, PALE, Pixel, grouped, short, style, write},
};
use crate::{Error, Result};

/// What a bake of so many patches took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Growth {
    /// Patches.
    pub patches: usize,
    /// Stages and their seconds.
    pub stages: Vec<(String, f64)>,
    /// Largest memory of the process, bytes.
    pub memory: u64,
    /// Of this, form factors.
    pub rows: u64,
}

impl Growth {
    /// Seconds of all stages.
    pub fn total(&self) -> f64 {
        self.stages.iter().map(|s| s.1).sum()
    }

    /// Seconds of a stage; zero if there was none.
    pub fn seconds(&self, stage: &str) -> f64 {
        self.stages.iter().filter(|s| s.0 == stage).map(|s| s.1).sum()
    }
}

/// A curve and what it is called.
type Curve = (String, RGBColor, Vec<(f64, f64)>);

const SIZE: (u32, u32) = (1320, 640);
/// Left, top, right, bottom of the panels; to their right stand the names of the curves.
const PANELS: [[i32; 4]; 2] = [[90, 100, 610, 570], [800, 100, 1180, 570]];
/// For stages beyond those that [`COLOURS`] has one for.
const MORE: [RGBColor; 2] = [RGBColor(86, 180, 233), RGBColor(130, 130, 130)];
/// Stages below this share of the time of the largest bake are left out.
const SHARE: f64 = 0.02;
/// Pixels between the names of two curves at least.
const APART: i32 = 17;
/// Lines of N log N in a decade of seconds or bytes.
const LINES: i32 = 2;

/// Draws time by stages on the left, memory on the right, over lines of N log N: a curve that grows no faster crosses them
/// only downwards.
///
/// # Errors
/// [`Error::Io`] if the picture cannot be drawn.
pub fn growth_svg(title: &str, bakes: &[Growth], machine: &Machine) -> Result<String> {
    let mut text = String::new();
    draw(&mut text, title, bakes, machine).map_err(|e| Error::io("the plot", std::io::Error::other(e.to_string())))?;
    Ok(text)
}

fn draw(text: &mut String, title: &str, bakes: &[Growth], machine: &Machine) -> Drawn {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    write(&root, title, (90, 22), 24, Anchor::LEFT)?;
    write(&root, &machine.to_string(), (90, 54), 14, Anchor::LEFT)?;
    let curve = |of: &dyn Fn(&Growth) -> f64| bakes.iter().map(|b| (b.patches as f64, of(b))).collect();
    let mut times: Vec<Curve> = vec![("all".into(), INK, curve(&Growth::total))];
    if let Some(last) = bakes.last() {
        let large = last.stages.iter().filter(|s| s.1 > SHARE * last.total());
        times.extend(
            large
                .zip(COLOURS.iter().chain(&MORE).cycle())
                .map(|((name, _), &colour)| (name.clone(), colour, curve(&|b| b.seconds(name)))),
        );
    }
    let memory = [
        ("whole bake".to_string(), INK, curve(&|b| b.memory as f64 * 1e-6)),
        ("form factors".to_string(), COLOURS[0], curve(&|b| b.rows as f64 * 1e-6)),
    ];
    panel(&root, PANELS[0], ["time", "seconds"], &times)?;
    panel(&root, PANELS[1], ["memory", "MB"], &memory)?;
    write(&root, "grey: lines of N log N", (PANELS[0][0], PANELS[0][3] + 52), 13, Anchor::LEFT)?;
    root.present()?;
    Ok(())
}

fn panel(root: &Area, edges: [i32; 4], [title, unit]: [&str; 2], curves: &[Curve]) -> Drawn {
    let [left, top, right, bottom] = edges;
    let all = || curves.iter().flat_map(|curve| &curve.2);
    let x = Axis::new(all().map(|p| p.0), left, right);
    let y = Axis::new(all().map(|p| p.1), bottom, top);
    let place = |&(patches, value): &(f64, f64)| (x.pixel(patches), y.pixel(value));

    for (value, _) in x.ticks() {
        let p = x.pixel(value);
        root.draw(&PathElement::new([(p, bottom), (p, bottom + 4)], INK))?;
        if value.log10().fract() == 0.0 {
            write(root, &grouped(value as usize), (p, bottom + 8), 14, Anchor::TOP)?;
        }
    }
    for (value, labelled) in y.ticks() {
        let p = y.pixel(value);
        root.draw(&PathElement::new([(left - 4, p), (left, p)], INK))?;
        if labelled {
            write(root, &short(value), (left - 8, p), 14, Anchor::RIGHT)?;
        }
    }
    for line in n_log_n(&x, &y, edges) {
        root.draw(&PathElement::new(line, PALE.stroke_width(1)))?;
    }
    root.draw(&Rectangle::new([(left, top), (right, bottom)], INK))?;
    let middle = (left + right) / 2;
    write(root, title, (middle, top - 10), 17, Anchor::BOTTOM)?;
    write(root, "patches", (middle, bottom + 32), 15, Anchor::TOP)?;
    let up = style(15, Anchor::BOTTOM).transform(FontTransform::Rotate270);
    root.draw_text(unit, &up, (left - 58, (top + bottom) / 2))?;

    for (k, (_, colour, points)) in curves.iter().enumerate() {
        let at: Vec<Pixel> = points.iter().filter(|p| p.1 > 0.0).map(place).collect();
        root.draw(&PathElement::new(at.clone(), colour.stroke_width(if k == 0 { 4 } else { 2 })))?;
        for p in at {
            root.draw(&Circle::new(p, 4, colour.filled()))?;
        }
    }
    // Names stand where their curves end, pushed apart.
    let mut ends: Vec<(i32, &Curve)> = curves.iter().filter_map(|c| Some((place(c.2.last()?).1, c))).collect();
    ends.sort_by_key(|end| end.0);
    let mut free = i32::MIN;
    for (end, (name, colour, points)) in ends {
        let at = end.max(free);
        free = at + APART;
        root.draw(&PathElement::new([(right, end), (right + 12, at)], *colour))?;
        let text = match (points.first(), points.last()) {
            (Some(a), Some(b)) if b.0 > a.0 => format!("{name}: N^{:.2}", (b.1 / a.1).ln() / (b.0 / a.0).ln()),
            _ => name.clone(),
        };
        write(root, &text, (right + 16, at), 14, Anchor::LEFT)?;
    }
    Ok(())
}

/// Lines of N log N through a panel, as pixels within its edges.
fn n_log_n(x: &Axis, y: &Axis, [left, top, right, bottom]: [i32; 4]) -> Vec<Vec<Pixel>> {
    let (from, to) = (10.0_f64.powf(x.low), 10.0_f64.powf(x.high));
    let level = |n: f64| n * n.ln();
    let steps = |v: f64| (v * LINES as f64).ceil() as i32;
    // By the value at the left edge: those that begin below the panel come in further right.
    let lowest = y.low - (level(to) / level(from)).log10();
    let line = |k: i32| -> Vec<Pixel> {
        let begin = 10.0_f64.powf(k as f64 / LINES as f64);
        let at = |p: i32| {
            let n = from * (to / from).powf((p - left) as f64 / (right - left) as f64);
            (p, y.pixel(begin * level(n) / level(from)))
        };
        (left..=right).map(at).filter(|p| (top..=bottom).contains(&p.1)).collect()
    };
    (steps(lowest)..=steps(y.high)).map(line).filter(|line| line.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_names_every_stage_that_counts_with_its_exponent() {
        let bake = |patches: usize, of: f64| Growth {
            patches,
            stages: vec![("solve".into(), 1e-5 * of), ("tiny".into(), 1e-9 * of), ("rows".into(), 1e-4 * of)],
            memory: 1000 * patches as u64,
            rows: 300 * patches as u64,
        };
        let machine = Machine { cpu: "A CPU".into(), threads: 2, version: "0.1.0", commit: None };
        let bakes = [bake(10_000, 1e4), bake(100_000, 1e5), bake(1_000_000, 1e7)];
        let text = growth_svg("a box", &bakes, &machine).unwrap();
        for label in ["a box", "A CPU", "solve: N^1.50", "rows: N^1.50", "whole bake: N^1.00", "100,000"] {
            assert!(text.contains(label), "{label}");
        }
        assert!(!text.contains("tiny"));
        // Of nothing, or of one bake, there is a picture too.
        assert!(growth_svg("a box", &[], &machine).unwrap().contains("time"));
        assert!(growth_svg("a box", &bakes[..1], &machine).unwrap().contains("solve"));
    }

    #[test]
    fn a_curve_of_n_log_n_runs_along_the_lines() {
        let edges = [100, 100, 600, 500];
        let (x, y) = (Axis::new([1e4, 1e6].into_iter(), 100, 600), Axis::new([0.1, 20.0].into_iter(), 500, 100));
        let lines = n_log_n(&x, &y, edges);
        assert!(lines.len() > 4);
        for line in lines {
            let value = |p: Pixel| 10.0_f64.powf(y.low + (500 - p.1) as f64 / 400.0 * (y.high - y.low));
            let n = |p: Pixel| 10.0_f64.powf(x.low + (p.0 - 100) as f64 / 500.0 * (x.high - x.low));
            let (a, b) = (line[0], line[line.len() - 1]);
            let factor = value(b) / value(a) / (n(b) * n(b).ln() / (n(a) * n(a).ln()));
            // A pixel is half a per cent of four decades.
            assert!((factor - 1.0).abs() < 0.05, "{factor}");
        }
    }
}
