//! Error against time as an SVG picture: log-log, total light on the left, indirect light on the right.

use std::error;

use plotters::{
    coord::Shift,
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use super::{
    Entry, Machine, Method, SceneBench,
    sweep::{RECONSTRUCTIONS, SOURCES},
};
use crate::{Error, Result};

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Drawn = std::result::Result<(), Box<dyn error::Error>>;
pub(super) type Pixel = (i32, i32);

const SIZE: (u32, u32) = (1560, 660);
/// Left, top, right, bottom of the panels.
const PANELS: [[i32; 4]; 2] = [[90, 110, 610, 590], [710, 110, 1230, 590]];
const LEGEND: Pixel = (1260, 122);

/// Colours that colour-blind readers can tell apart (Okabe & Ito 2008): one a patch source.
pub(super) const COLOURS: [RGBColor; 5] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
];
pub(super) const INK: RGBColor = RGBColor(40, 40, 40);
pub(super) const PALE: RGBColor = RGBColor(225, 225, 225);
const PATHS: RGBColor = RGBColor(110, 110, 110);
const FRONT: RGBColor = RGBColor(250, 200, 60);

/// Draws a scene's entries. Colours tell the patches, shapes the reconstruction; ray tracers other than the first are
/// hollow. The Pareto front of each panel is marked and labelled.
///
/// # Errors
/// [`Error::Io`] if the picture cannot be drawn.
pub fn svg(bench: &SceneBench, machine: &Machine) -> Result<String> {
    let mut text = String::new();
    draw(&mut text, bench, machine).map_err(|e| Error::io("the plot", std::io::Error::other(e.to_string())))?;
    Ok(text)
}

fn draw(text: &mut String, bench: &SceneBench, machine: &Machine) -> Drawn {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    write(&root, &format!("{}: error against time", bench.name), (90, 22), 24, Anchor::LEFT)?;
    let (paths, noise) = bench.reference;
    let line = format!(
        "{machine}; {} triangles; reference: {paths} paths a point, standard error {:.2} %",
        bench.triangles,
        100.0 * noise
    );
    write(&root, &line, (90, 54), 14, Anchor::LEFT)?;
    let titles = ["all light", "indirect light"];
    for ((panel, title), error) in PANELS.into_iter().zip(titles).zip([total as fn(&Entry) -> f64, indirect]) {
        // What is nearer to the reference than that can tell stands at a tenth of its noise.
        let least = 0.1 * noise.max(1e-6);
        let at: Vec<(f64, f64)> = bench.entries.iter().map(|e| (e.seconds, error(e).max(least))).collect();
        self::panel(&root, panel, title, bench, &at)?;
    }
    legend(&root, bench)?;
    root.present()?;
    Ok(())
}

fn total(entry: &Entry) -> f64 {
    entry.total.rmse
}

fn indirect(entry: &Entry) -> f64 {
    entry.indirect.rmse
}

fn panel(root: &Area, edges: [i32; 4], title: &str, bench: &SceneBench, at: &[(f64, f64)]) -> Drawn {
    let [left, top, right, bottom] = edges;
    let x = Axis::new(at.iter().map(|p| p.0), left, right);
    let y = Axis::new(at.iter().map(|p| 100.0 * p.1), bottom, top);
    let place = |(seconds, error): (f64, f64)| (x.pixel(seconds), y.pixel(100.0 * error));

    for (value, labelled) in x.ticks() {
        let p = x.pixel(value);
        root.draw(&PathElement::new([(p, top), (p, bottom)], PALE))?;
        if labelled {
            write(root, &short(value), (p, bottom + 8), 14, Anchor::TOP)?;
        }
    }
    for (value, labelled) in y.ticks() {
        let p = y.pixel(value);
        root.draw(&PathElement::new([(left, p), (right, p)], PALE))?;
        if labelled {
            write(root, &short(value), (left - 8, p), 14, Anchor::RIGHT)?;
        }
    }
    root.draw(&Rectangle::new([(left, top), (right, bottom)], INK))?;
    let middle = (left + right) / 2;
    write(root, title, (middle, top - 10), 17, Anchor::BOTTOM)?;
    let job = format!("seconds for {} points", grouped(bench.settings.job));
    write(root, &job, (middle, bottom + 32), 15, Anchor::TOP)?;
    let up = style(15, Anchor::BOTTOM).transform(FontTransform::Rotate270);
    root.draw_text("relative RMSE of luminance, %", &up, (left - 52, (top + bottom) / 2))?;

    // Underneath: the front, and the path tracer's curve.
    let front = super::pareto::front(at);
    let mut on: Vec<(f64, f64)> = at.iter().zip(&front).filter(|(_, on)| **on).map(|(p, _)| *p).collect();
    on.sort_by(|a, b| a.0.total_cmp(&b.0));
    root.draw(&PathElement::new(on.iter().map(|p| place(*p)).collect::<Vec<_>>(), FRONT.stroke_width(7)))?;
    let traced = bench.entries.iter().zip(at).filter(|(e, _)| matches!(e.method, Method::Paths(_)));
    let traced: Vec<Pixel> = traced.map(|(_, p)| place(*p)).collect();
    root.draw(&PathElement::new(traced, PATHS.stroke_width(2)))?;

    for ((entry, p), on) in bench.entries.iter().zip(at).zip(front) {
        let p = place(*p);
        marker(root, &entry.method, bench, p)?;
        // The front has free space on its lower left, the path tracer's curve on its upper right.
        if matches!(entry.method, Method::Paths(_)) {
            let (at, anchor) = if p.0 + 80 < right { (7, Anchor::LOWER_LEFT) } else { (-7, Anchor::UPPER_RIGHT) };
            write(root, &entry.method.label(), (p.0 + at, p.1 - 5), 12, anchor)?;
        } else if on {
            write(root, &entry.method.label(), (p.0 - 8, p.1 + 6), 12, Anchor::UPPER_RIGHT)?;
        }
    }
    Ok(())
}

/// The sign of a method.
fn marker(root: &Area, method: &Method, bench: &SceneBench, (x, y): Pixel) -> Drawn {
    let Method::Bake(c) = method else {
        return Ok(root.draw(&Rectangle::new([(x - 3, y - 3), (x + 3, y + 3)], PATHS.filled()))?);
    };
    let place = |position: Option<usize>| position.unwrap_or_default();
    let colour = COLOURS[place(SOURCES.iter().position(|s| *s == c.patches)) % COLOURS.len()];
    // Six pixels around the place.
    let shape: &[Pixel] = match place(RECONSTRUCTIONS.iter().position(|r| *r == c.reconstruct)) {
        0 => &[],
        1 => &[(0, -7), (6, 5), (-6, 5)],
        2 => &[(-5, -5), (5, -5), (5, 5), (-5, 5)],
        _ => &[(0, -7), (7, 0), (0, 7), (-7, 0)],
    };
    let hollow = Some(c.backend) != first_backend(bench);
    let outline: Vec<Pixel> = shape.iter().map(|(dx, dy)| (x + dx, y + dy)).collect();
    let fill = if hollow { WHITE.filled() } else { colour.filled() };
    if outline.is_empty() {
        root.draw(&Circle::new((x, y), 5, fill))?;
        root.draw(&Circle::new((x, y), 5, colour.stroke_width(2)))?;
    } else {
        root.draw(&Polygon::new(outline.clone(), fill))?;
        let closed: Vec<Pixel> = outline.iter().chain(outline.first()).copied().collect();
        root.draw(&PathElement::new(closed, colour.stroke_width(2)))?;
    }
    Ok(())
}

fn first_backend(bench: &SceneBench) -> Option<crate::options::Backend> {
    bench.entries.iter().find_map(|e| match e.method {
        Method::Bake(c) => Some(c.backend),
        Method::Paths(_) => None,
    })
}

fn legend(root: &Area, bench: &SceneBench) -> Drawn {
    let (x, mut y) = LEGEND;
    let mut told: Vec<(String, &Method)> = Vec::new();
    for entry in &bench.entries {
        let series = entry.method.series();
        if told.iter().all(|t| t.0 != series) {
            told.push((series, &entry.method));
        }
    }
    // Many series stand closer together.
    let step = ((PANELS[0][3] - y) / (told.len() as i32 + 1)).min(24);
    for (series, method) in told {
        marker(root, method, bench, (x, y))?;
        write(root, &series, (x + 16, y), step.min(14), Anchor::LEFT)?;
        y += step;
    }
    root.draw(&PathElement::new([(x - 8, y), (x + 8, y)], FRONT.stroke_width(7)))?;
    write(root, "Pareto front", (x + 16, y), 14, Anchor::LEFT)?;
    write(root, "labels: grid/rays a patch", (x - 8, PANELS[0][3] + 22), 13, Anchor::LEFT)?;
    Ok(())
}

/// A logarithmic axis from one pixel to another.
pub(super) struct Axis {
    pub low: f64,
    pub high: f64,
    from: i32,
    to: i32,
}

impl Axis {
    /// Around all values, with some room at both ends.
    pub fn new(values: impl Iterator<Item = f64>, from: i32, to: i32) -> Axis {
        let logs: Vec<f64> = values.filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10).collect();
        let (low, high) = logs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let (low, high) = if logs.is_empty() { (-1.0, 1.0) } else { (low, high) };
        let room = 0.14 * (high - low).max(0.5);
        Axis { low: low - room, high: high + room, from, to }
    }

    pub fn pixel(&self, value: f64) -> i32 {
        let share = (value.log10() - self.low) / (self.high - self.low);
        // What is not finite stands at the far end.
        let share = if share.is_finite() { share } else { 1.0 };
        self.from + (share * (self.to - self.from) as f64).round() as i32
    }

    /// 1, 2, 5 of every decade; whether each has its number written.
    pub fn ticks(&self) -> Vec<(f64, bool)> {
        let wide = self.high - self.low > 3.2;
        let decades = self.low.floor() as i32..=self.high.ceil() as i32;
        let all = decades.flat_map(|d| [1.0, 2.0, 5.0].map(|m| (m * 10.0_f64.powi(d), m == 1.0 || !wide)));
        all.filter(|(v, _)| (self.low..=self.high).contains(&v.log10())).collect()
    }
}

/// With a comma between thousands.
pub(super) fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let comma = |i: usize| i > 0 && (digits.len() - i).is_multiple_of(3);
    digits.chars().enumerate().flat_map(|(i, c)| comma(i).then_some(',').into_iter().chain([c])).collect()
}

/// Without digits that say nothing.
pub(super) fn short(value: f64) -> String {
    let digits = (-value.log10().floor()).max(0.0) as usize;
    format!("{value:.digits$}")
}

/// Where a text lies from its place.
#[derive(Clone, Copy)]
pub(super) struct Anchor(HPos, VPos);

impl Anchor {
    pub const LEFT: Anchor = Anchor(HPos::Left, VPos::Center);
    pub const RIGHT: Anchor = Anchor(HPos::Right, VPos::Center);
    pub const TOP: Anchor = Anchor(HPos::Center, VPos::Top);
    pub const BOTTOM: Anchor = Anchor(HPos::Center, VPos::Bottom);
    const LOWER_LEFT: Anchor = Anchor(HPos::Left, VPos::Bottom);
    const UPPER_RIGHT: Anchor = Anchor(HPos::Right, VPos::Top);
}

pub(super) fn style(size: i32, Anchor(h, v): Anchor) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK).pos(Pos::new(h, v))
}

pub(super) fn write(root: &Area, text: &str, at: Pixel, size: i32, anchor: Anchor) -> Drawn {
    Ok(root.draw_text(text, &style(size, anchor), at)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_logarithmic_and_has_ticks_between_its_ends() {
        let axis = Axis { low: -1.0, high: 1.0, from: 100, to: 300 };
        assert_eq!([0.1, 1.0, 10.0, f64::NAN].map(|v| axis.pixel(v)), [100, 200, 300, 300]);
        let ticks: Vec<f64> = axis.ticks().iter().map(|t| t.0).collect();
        assert_eq!(ticks.len(), 7, "{ticks:?}");
        assert!(axis.ticks().iter().all(|t| t.1));
        let wide = Axis { high: 3.0, ..axis };
        assert_eq!(wide.ticks().iter().filter(|t| t.1).count(), 5);
        // Around its values, whatever they are.
        for values in [vec![], vec![0.0, f64::NAN], vec![3.0], vec![0.01, 100.0]] {
            let axis = Axis::new(values.iter().copied(), 0, 500);
            assert!(values.iter().filter(|v| **v > 0.0).all(|v| (1..500).contains(&axis.pixel(*v))), "{values:?}");
        }
    }

    #[test]
    fn numbers_have_the_digits_they_need() {
        assert_eq!([0.05, 0.2, 1.0, 20.0].map(short), ["0.05", "0.2", "1", "20"]);
        assert_eq!([5, 100_000, 1234].map(grouped), ["5", "100,000", "1,234"]);
    }
}
