//! Makes the text of an OBJ file fit for tobj, and keeps what tobj loses.
//!
//! tobj 4.0 reports no line numbers, knows no line continuation or byte-order mark, forgets the names of undefined
//! materials, hands on faces with one or two corners, and mixes up attributes when only some corners of a mesh have
//! them. So the text is checked here first, statement by statement, and given on as runs of faces that are alike.

use std::fmt::Write;

/// Faces in a row with one group, one material and the same attributes; tobj makes one model of it.
#[derive(Debug, PartialEq)]
pub(crate) struct Run {
    /// Names of object and group.
    pub name: String,
    /// Name of the material; `None` before the first `usemtl`.
    pub material: Option<String>,
    /// Line of every face.
    pub lines: Vec<u32>,
    attributes: (bool, bool),
}

/// What the text holds.
#[derive(Debug, Default)]
pub(crate) struct Scan {
    /// `v`, `vt`, `vn`, `f` statements that are right, and an `o` before each run.
    pub text: String,
    pub runs: Vec<Run>,
    /// Material libraries in order.
    pub libraries: Vec<String>,
    /// Lines of faces with fewer than three corners, which were left out.
    pub short_faces: Vec<u32>,
    /// Whether only some vertices have a colour.
    pub mixed_colours: bool,
}

/// Scans a whole file. The error is (line number, message).
pub(crate) fn scan(text: &str) -> Result<Scan, (u32, String)> {
    let mut scanner = Scanner { out: Scan::default(), ..Scanner::default() };
    scanner.out.text.reserve(text.len());
    let mut joined = String::new();
    let mut first_line = 0;
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let number = number as u32 + 1;
        let line = line.trim_end();
        if let Some(part) = line.strip_suffix('\\') {
            if joined.is_empty() {
                first_line = number;
            }
            joined.push_str(part);
            joined.push(' ');
        } else if joined.is_empty() {
            scanner.statement(number, line).map_err(|m| (number, m))?;
        } else {
            joined.push_str(line);
            scanner.statement(first_line, &joined).map_err(|m| (first_line, m))?;
            joined.clear();
        }
    }
    if !joined.is_empty() {
        scanner.statement(first_line, &joined).map_err(|m| (first_line, m))?;
    }
    Ok(scanner.out)
}

#[derive(Default)]
struct Scanner {
    out: Scan,
    object: String,
    group: String,
    material: Option<String>,
    positions: usize,
    uvs: usize,
    normals: usize,
    coloured: bool,
    new_run: bool,
    face: String,
}

impl Scanner {
    fn statement(&mut self, number: u32, line: &str) -> Result<(), String> {
        let line = without_comment(line).trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match key {
            "v" => self.vertex(rest)?,
            "vt" => {
                self.uvs += 1;
                self.numbers("vt", rest, 1, 2)?;
            }
            "vn" => {
                self.normals += 1;
                self.numbers("vn", rest, 3, 3)?;
            }
            "f" | "fo" => self.face(number, rest)?,
            "o" => self.rename(rest, true),
            "g" => self.rename(rest, false),
            "usemtl" => {
                self.material = Some(rest.trim().to_string());
                self.new_run = true;
            }
            "mtllib" => self.out.libraries.push(rest.trim().to_string()),
            _ => {}
        }
        Ok(())
    }

    fn rename(&mut self, name: &str, object: bool) {
        let slot = if object { &mut self.object } else { &mut self.group };
        *slot = name.trim().to_string();
        if object {
            self.group.clear();
        }
        self.new_run = true;
    }

    fn vertex(&mut self, rest: &str) -> Result<(), String> {
        self.positions += 1;
        let coloured = rest.split_whitespace().count() >= 6;
        self.numbers("v", rest, 3, if coloured { 6 } else { 3 })?;
        // tobj wants colours of all vertices or of none: once one has a colour, the others are white.
        if coloured && !self.coloured && self.positions > 1 {
            self.out.mixed_colours = true;
            self.out.text = whiten(&self.out.text);
        } else if !coloured && self.coloured {
            self.out.mixed_colours = true;
            self.out.text.pop();
            self.out.text.push_str(" 1 1 1\n");
        }
        self.coloured |= coloured;
        Ok(())
    }

    /// Checks and copies `least` ..= `most` numbers; missing ones up to `most` become 0.
    fn numbers(&mut self, key: &str, rest: &str, least: usize, most: usize) -> Result<(), String> {
        self.out.text.push_str(key);
        let mut n = 0;
        for word in rest.split_whitespace().take(most) {
            if word.parse::<f64>().is_err() {
                return Err(format!("\"{word}\" in \"{key} {rest}\" is no number; write it like 1.5 or 2e-3"));
            }
            self.out.text.push(' ');
            self.out.text.push_str(word);
            n += 1;
        }
        if n < least {
            return Err(format!("\"{key} {rest}\" has {n} numbers, {least} are needed"));
        }
        for _ in n..most {
            self.out.text.push_str(" 0");
        }
        self.out.text.push('\n');
        Ok(())
    }

    fn face(&mut self, number: u32, rest: &str) -> Result<(), String> {
        let mut face = std::mem::take(&mut self.face);
        face.clear();
        face.push('f');
        let (mut corners, mut all_uv, mut all_normal) = (0, true, true);
        let start = face.len();
        // Attributes that only some corners of a face have are of no use: a second pass leaves them out.
        for pass in 0..2 {
            corners = 0;
            face.truncate(start);
            for word in rest.split_whitespace() {
                let mut parts = word.split('/');
                let v = index("vertex", parts.next().unwrap_or(""), self.positions)?;
                let vt = optional("texture coordinate", parts.next(), self.uvs)?;
                let vn = optional("normal", parts.next(), self.normals)?;
                if parts.next().is_some() {
                    return Err(format!("corner \"{word}\" has more than three indices"));
                }
                corners += 1;
                all_uv &= vt.is_some();
                all_normal &= vn.is_some();
                let (vt, vn) = (vt.filter(|_| all_uv), vn.filter(|_| all_normal));
                let _ = match (vt, vn) {
                    (Some(t), Some(n)) => write!(face, " {v}/{t}/{n}"),
                    (Some(t), None) => write!(face, " {v}/{t}"),
                    (None, Some(n)) => write!(face, " {v}//{n}"),
                    (None, None) => write!(face, " {v}"),
                };
            }
            if pass == 0 && corners_alike(rest, all_uv, all_normal) {
                break;
            }
        }
        if corners < 3 {
            self.out.short_faces.push(number);
        } else {
            self.begin_run((all_uv, all_normal));
            self.out.text.push_str(&face);
            self.out.text.push('\n');
            if let Some(run) = self.out.runs.last_mut() {
                run.lines.push(number);
            }
        }
        self.face = face;
        Ok(())
    }

    fn begin_run(&mut self, attributes: (bool, bool)) {
        if !self.new_run && self.out.runs.last().is_some_and(|r| r.attributes == attributes) {
            return;
        }
        self.new_run = false;
        let name = match (self.object.as_str(), self.group.as_str()) {
            ("", "") => "default".to_string(),
            (name, "") | ("", name) => name.to_string(),
            (object, group) => format!("{object}/{group}"),
        };
        let _ = writeln!(self.out.text, "o {}", self.out.runs.len());
        self.out.runs.push(Run { name, material: self.material.clone(), lines: Vec::new(), attributes });
    }
}

/// The line up to a `#` that stands at its start or behind a space; `1.#INF` and names may hold one.
pub(crate) fn without_comment(line: &str) -> &str {
    let comment = line.match_indices('#').find(|(i, _)| line[..*i].chars().next_back().is_none_or(char::is_whitespace));
    comment.map_or(line, |(i, _)| &line[..i])
}

/// Adds white to all vertices without a colour.
fn whiten(text: &str) -> String {
    let mut out = String::with_capacity(text.len() * 5 / 4);
    for line in text.lines() {
        out.push_str(line);
        if line.starts_with("v ") && line.split(' ').count() == 4 {
            out.push_str(" 1 1 1");
        }
        out.push('\n');
    }
    out
}

/// Whether the first corner already told which attributes all corners have.
fn corners_alike(rest: &str, all_uv: bool, all_normal: bool) -> bool {
    let has = |n: usize| {
        rest.split_whitespace().next().and_then(|w| w.split('/').nth(n)).is_some_and(|part| !part.is_empty())
    };
    has(1) == all_uv && has(2) == all_normal
}

fn optional(what: &str, word: Option<&str>, count: usize) -> Result<Option<usize>, String> {
    word.filter(|w| !w.is_empty()).map(|w| index(what, w, count)).transpose()
}

/// An absolute index, 1 ..= count, from one that may count backwards.
fn index(what: &str, word: &str, count: usize) -> Result<usize, String> {
    let wrong = || format!("{what} index \"{word}\" does not exist; there are {count} so far, the first is 1");
    let value: i64 = word.parse().map_err(|_| wrong())?;
    let count_i = count as i64;
    let index = if value < 0 { count_i + 1 + value } else { value };
    if index < 1 || index > count_i { Err(wrong()) } else { Ok(index as usize) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn continued_lines_are_one_statement_of_the_first_line() {
        let scan = scan("v 0 0 0\nv 1 0 0\nv 0 1 \\\n 0\nf 1 \\\r\n 2 3\n").unwrap();
        assert_eq!(scan.text, "v 0 0 0\nv 1 0 0\nv 0 1 0\no 0\nf 1 2 3\n");
        assert_eq!(scan.runs[0].lines, [5]);
    }

    #[test]
    fn attributes_of_only_some_corners_are_left_out() {
        let scan = scan("v 0 0 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 1//1 1/1/1\nf 1 1/1 1\nf -1/-1 1/1 1/1\n").unwrap();
        let faces: Vec<&str> = scan.text.lines().filter(|l| l.starts_with('f')).collect();
        assert_eq!(faces, ["f 1//1 1//1 1//1", "f 1 1 1", "f 1/1 1/1 1/1"]);
        assert_eq!(scan.runs.len(), 3);
    }

    #[test]
    fn vertices_without_a_colour_become_white_if_any_has_one() {
        let scan = scan("v 0 0 0\nv 1 0 0 1 0 0\nv 2 0 0\n").unwrap();
        assert_eq!(scan.text, "v 0 0 0 1 1 1\nv 1 0 0 1 0 0\nv 2 0 0 1 1 1\n");
        assert!(scan.mixed_colours);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, line) in [
            ("v 0 0 0\nv 1,5 0 0\n", 2),
            ("v 0 0 0\n\nf 1 1 2\n", 3),
            ("f 0 0 0\n", 1),
            ("v 0 0 0\nf 1 1 -2\n", 2),
            ("v 0 0 0\nf 1 1 99999999999999999999\n", 2),
            ("v 0 0\n", 1),
            ("v 0 0 1.#INF\n", 1),
            ("v 0 0 0\nf 1/1 1 1\n", 2),
        ] {
            assert_eq!(scan(text).unwrap_err().0, line, "{text}");
        }
    }
}
