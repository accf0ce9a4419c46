//! `luxel points`.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use glam::{DVec3, Vec3};
use luxel::{
    Error, Result,
    bake::{Irradiance, Run},
    lxt::Cache,
    output::{
        atomic::{Staged, check_is_no_input, place_of},
        report::summary,
    },
    progress,
    scene::{Frame, SurfacePoint},
};

use super::{
    args::{BakeArgs, Goals},
    progress::{Style, Terminal},
    say,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Points: `x y z nx ny nz` a line, separated by blanks or commas; `#` begins a comment
    #[arg(long, value_name = "FILE")]
    at: PathBuf,
    /// CSV file to write, irradiance in W/m2
    #[arg(long, short, value_name = "OUT.csv")]
    output: PathBuf,
    /// Folder of rows from earlier bakes: see `luxel bake`
    #[arg(long, value_name = "DIR", conflicts_with_all = ["target_error", "budget"])]
    cache: Option<PathBuf>,
    #[command(flatten)]
    goals: Goals,
    #[command(flatten)]
    bake: BakeArgs,
}

/// A point of the world with its unit normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub position: DVec3,
    pub normal: DVec3,
}

impl Point {
    /// The point in the frame of a scene.
    pub fn local(&self, frame: &Frame) -> SurfacePoint {
        SurfacePoint { position: frame.to_local(self.position), normal: self.normal.as_vec3().normalize() }
    }
}

pub fn run(args: &Args) -> Result<()> {
    let points = read(&args.at)?;
    let job = args.bake.load()?;
    let scene = &job.scene;
    let goal = args.bake.goal(&args.goals);
    let (folder, name) = place_of(&args.output)?;
    check_is_no_input(&args.output, &[&args.at, &args.bake.scene])?;
    let cache = args.cache.as_deref().map(Cache::open).transpose()?;
    let mut staged = Staged::open(folder)?;
    let running = &args.bake.running;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    let (bake, light) = job.on_threads(|| {
        let bake = match &cache {
            Some(cache) => {
                let mut run = Run { progress: &progress, keeper: &mut (), deadline: None };
                cache.bake(scene, &job.options, &mut run)?
            }
            None => luxel::bake_to(scene, &job.options, &goal, &progress)?,
        };
        let light = bake.irradiance(&points.iter().map(|p| p.local(&scene.frame)).collect::<Vec<_>>(), &progress);
        progress::go_on(&progress, "points")?;
        Ok((bake, light))
    })?;
    staged.write(name, |out| write(out, &points, &light))?;
    staged.commit()?;
    if !running.quiet && !running.json_progress {
        say(&summary(scene, &bake.report));
        say(&format!("{:<14}{} points to {}\n", "written", points.len(), args.output.display()));
    }
    Ok(())
}

/// Reads a file of points.
pub(super) fn read(path: &Path) -> Result<Vec<Point>> {
    let text = fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    parse(path, &text)
}

/// Reads the points of `text`; errors name the line of `path`.
fn parse(path: &Path, text: &str) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for (i, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let content = line.split('#').next().unwrap_or_default();
        let fields: Vec<&str> = content.split([' ', '\t', ',', '\r']).filter(|f| !f.is_empty()).collect();
        if fields.is_empty() {
            continue;
        }
        let point = parse_point(&fields).map_err(|m| Error::input(path, format!("line {}", i + 1), m))?;
        points.push(point);
    }
    if points.is_empty() {
        return Err(Error::input(path, "", "holds no points; lines of `x y z nx ny nz` were expected"));
    }
    Ok(points)
}

fn parse_point(fields: &[&str]) -> std::result::Result<Point, String> {
    let numbers = fields.iter().map(|f| super::parse::number(f)).collect::<std::result::Result<Vec<f64>, _>>()?;
    let &[x, y, z, nx, ny, nz] = numbers.as_slice() else {
        return Err(format!("6 numbers (x y z nx ny nz) were expected, not {}", numbers.len()));
    };
    let normal = DVec3::new(nx, ny, nz);
    // Scaled first: squares of tiny or huge numbers leave the range of f64.
    let normal = (normal / normal.abs().max_element()).try_normalize().ok_or("the normal has no length")?;
    Ok(Point { position: DVec3::new(x, y, z), normal })
}

fn write(out: &mut dyn Write, points: &[Point], light: &Irradiance) -> io::Result<()> {
    writeln!(out, "x,y,z,nx,ny,nz,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b")?;
    for (i, p) in points.iter().enumerate() {
        let join = |v: Vec3| format!("{},{},{}", v.x, v.y, v.z);
        let (p, n) = (p.position, p.normal);
        write!(out, "{},{},{},{},{},{},", p.x, p.y, p.z, n.x, n.y, n.z)?;
        writeln!(out, "{},{}", join(light.direct[i]), join(light.indirect[i]))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<Vec<Point>, String> {
        parse(Path::new("p.txt"), text).map_err(|e| e.to_string())
    }

    #[test]
    fn points_are_separated_by_blanks_or_commas_and_normals_become_unit() {
        let points = read("# head\n\n1 2 3 0 0 2\r\n 4,5,6, 0,-1e-300,0 # tail\n1\t2\t3\t0\t3\t4").unwrap();
        assert_eq!(points.len(), 3);
        assert_eq!(points[0], Point { position: DVec3::new(1.0, 2.0, 3.0), normal: DVec3::Z });
        assert_eq!(points[1], Point { position: DVec3::new(4.0, 5.0, 6.0), normal: DVec3::NEG_Y });
        assert!((points[2].normal - DVec3::new(0.0, 0.6, 0.8)).length() < 1e-15);
    }

    #[test]
    fn a_wrong_line_is_named() {
        let good = "1 2 3 0 0 1\n";
        let error = |bad: &str| read(&format!("{good}{bad}")).unwrap_err();
        assert_eq!(error("1 2 3"), "p.txt: line 2: 6 numbers (x y z nx ny nz) were expected, not 3");
        assert_eq!(error("1 2 3 0 0 0"), "p.txt: line 2: the normal has no length");
        assert_eq!(error("1 2 x 0 0 1"), "p.txt: line 2: \"x\" is not a number");
        assert_eq!(error("1 2 nan 0 0 1"), "p.txt: line 2: nan is not finite");
        assert!(read("# nothing\n").unwrap_err().starts_with("p.txt: holds no points"));
    }

    #[test]
    fn rows_have_the_columns_of_the_header() {
        let points = read("1 2 3 0 0 1\n-0.1 1e-9 5 1 0 0").unwrap();
        let light = Irradiance { direct: vec![Vec3::X, Vec3::splat(0.1)], indirect: vec![Vec3::Y, Vec3::Z] };
        let mut out = Vec::new();
        write(&mut out, &points, &light).unwrap();
        let text = String::from_utf8(out).unwrap();
        let rows: Vec<&str> = text.lines().skip(1).collect();
        assert_eq!(rows, ["1,2,3,0,0,1,1,0,0,0,1,0", "-0.1,0.000000001,5,1,0,0,0.1,0.1,0.1,0,0,1"]);
    }
}
