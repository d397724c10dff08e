//! STL files as CAD programs and scanners write them: binary, or text with one solid or several.
//!
//! Binary: 80 bytes of any content, the number n of triangles (u32), then 50 bytes a triangle
//! (normal and three corners as f32, two bytes of attributes), all little-endian. Text:
//! `solid NAME`, `facet normal`, `outer loop`, three `vertex x y z`, `endloop`, `endfacet`,
//! `endsolid`, in any case and with any blanks (Marshall Burns, Automated Fabrication, 1993,
//! section 6.5). A header that begins with "solid" tells nothing: the length does.

use std::collections::HashMap;
use wcal_core::text;

/// Largest number of triangles that is read: corners, edges and the tree that is searched take 0.6
/// kB a triangle, twice that in closed bodies.
pub(crate) const MAX_TRIANGLES: usize = 1_000_000;
/// Largest file, bytes: a text has some 250 bytes a triangle.
pub const MAX_BYTES: u64 = 400 << 20;
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// Corners and triangles of a file; equal corners are one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stl {
    /// Corners, in the unit of the file.
    pub points: Vec<[f32; 3]>,
    /// Triangles by their corners.
    pub triangles: Vec<[u32; 3]>,
    /// What is remarkable, in words.
    pub notes: Vec<String>,
    known: HashMap<[u32; 3], u32>,
}

impl Stl {
    /// Reads a file's bytes; all solids of a text become one surface.
    ///
    /// # Errors
    /// What was expected and found: no STL, cut off, too many triangles, or a line that has no
    /// place.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        if bytes.is_empty() {
            return Err("expected an STL file, found an empty file".to_owned());
        }
        let stated = stated_triangles(bytes);
        let whole =
            stated.is_some_and(|n| HEADER as u64 + TRIANGLE as u64 * n == bytes.len() as u64);
        if !whole && begins_as_text(bytes) {
            return Self::text(bytes);
        }
        if let Some(form) = other_form(bytes).filter(|_| !whole) {
            return Err(format!("expected an STL file, found {form}"));
        }
        match stated {
            Some(n) => Self::binary(bytes, n),
            None => Err(format!(
                "expected \"solid\" or {HEADER} bytes of header, found {} other bytes",
                bytes.len()
            )),
        }
    }

    fn binary(bytes: &[u8], stated: u64) -> Result<Self, String> {
        check_count(stated)?;
        let body = &bytes[HEADER..];
        let end = stated as usize * TRIANGLE;
        if body.len() < end {
            let there = body.len() / TRIANGLE;
            return Err(format!(
                "expected {stated} triangles as the header states, found {there}: cut off"
            ));
        }
        let mut all = Self::default();
        for triangle in body[..end].chunks_exact(TRIANGLE) {
            let (numbers, _) = triangle.as_chunks::<4>();
            // The first three numbers are the normal, which the corners say as well.
            let corner = |k: usize| [0, 1, 2].map(|axis| f32::from_le_bytes(numbers[k + axis]));
            all.push([3, 6, 9].map(corner));
        }
        if body.len() > end {
            all.notes.push(format!(
                "{} bytes after the last triangle are left out",
                body.len() - end
            ));
        }
        Ok(all)
    }

    /// As a binary file; readers take the normals from the corners.
    pub(crate) fn to_binary(&self) -> Vec<u8> {
        let mut bytes = vec![0; HEADER - 4];
        bytes.extend((self.triangles.len() as u32).to_le_bytes());
        for triangle in &self.triangles {
            let corners = triangle.iter().flat_map(|k| self.points[*k as usize]);
            [0.0; 3]
                .into_iter()
                .chain(corners)
                .for_each(|x| bytes.extend(x.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn text(bytes: &[u8]) -> Result<Self, String> {
        if let Some(other) = text::other_than_text(bytes) {
            return Err(other.to_string());
        }
        // Names may be in any encoding.
        let text = String::from_utf8_lossy(bytes);
        let text = text.trim_start_matches('\u{feff}');
        let ends: &[char] = if text.contains('\n') {
            &['\n']
        } else {
            &['\r']
        };
        let (mut all, mut corners) = (Self::default(), Vec::with_capacity(3));
        let (mut in_solid, mut in_facet) = (false, false);
        for (k, line) in text.split(ends).enumerate() {
            let mut words = line.split_ascii_whitespace();
            let Some(first) = words.next() else { continue };
            let wrong = |expected: &str| {
                let found: String = line.trim().chars().take(40).collect();
                format!("line {}: expected {expected}, found {found:?}", k + 1)
            };
            match (first.to_ascii_lowercase().as_str(), in_solid, in_facet) {
                ("solid", _, false) => in_solid = true,
                ("endsolid", true, false) => in_solid = false,
                ("facet", true, false) => in_facet = true,
                ("outer" | "endloop", _, true) => {}
                ("vertex", _, true) => {
                    let numbers: Vec<f32> = words.map_while(|w| w.parse().ok()).collect();
                    let corner: [f32; 3] = numbers
                        .try_into()
                        .map_err(|_| wrong("vertex and three numbers"))?;
                    corners.push(corner);
                }
                ("endfacet", _, true) => {
                    let triangle = corners[..]
                        .try_into()
                        .map_err(|_| wrong("three vertices before endfacet"))?;
                    check_count(all.triangles.len() as u64 + 1)?;
                    all.push(triangle);
                    corners.clear();
                    in_facet = false;
                }
                (_, true, true) => return Err(wrong("outer loop, vertex, endloop or endfacet")),
                (_, true, false) => return Err(wrong("facet or endsolid")),
                (_, false, _) => return Err(wrong("solid")),
            }
        }
        if in_solid {
            Err("expected endsolid, found the end of the file: cut off".to_owned())
        } else {
            Ok(all)
        }
    }

    pub(crate) fn push(&mut self, corners: [[f32; 3]; 3]) {
        let Self { points, known, .. } = self;
        let triangle = corners.map(|corner| {
            *known.entry(corner.map(f32::to_bits)).or_insert_with(|| {
                points.push(corner);
                (points.len() - 1) as u32
            })
        });
        self.triangles.push(triangle);
    }
}

/// The number that a binary file states.
fn stated_triangles(bytes: &[u8]) -> Option<u64> {
    let count: [u8; 4] = bytes.get(HEADER - 4..HEADER)?.try_into().ok()?;
    Some(u64::from(u32::from_le_bytes(count)))
}

fn begins_as_text(bytes: &[u8]) -> bool {
    let bytes = bytes
        .strip_prefix(b"\xef\xbb\xbf")
        .unwrap_or(bytes)
        .trim_ascii_start();
    bytes.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
        // A binary header may begin so, too; the numbers after it hold zeros.
        && !bytes[..bytes.len().min(4096)].contains(&0)
}

/// What a file is that is no STL, by its first bytes, and what to do.
fn other_form(bytes: &[u8]) -> Option<String> {
    const MARKS: [(&[u8], &str); 6] = [
        (b"OFF", "OFF"),
        (b"glTF", "glTF"),
        (b"ISO-10303-21", "STEP"),
        (b"#VRML", "VRML"),
        (b"<?xml", "XML (Collada, X3D, AMF)"),
        (b"PK\x03\x04", "3MF or zip"),
    ];
    let (_, form) = MARKS.iter().find(|(mark, _)| bytes.starts_with(mark))?;
    Some(format!("{form} (save it as STL, OBJ or PLY)"))
}

/// Whether so many triangles are read.
pub(crate) fn check_count(triangles: u64) -> Result<(), String> {
    if triangles <= MAX_TRIANGLES as u64 {
        return Ok(());
    }
    Err(format!(
        "expected at most {MAX_TRIANGLES} triangles, found {triangles}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "solid a\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 4 0 0\n   vertex 0 4 0\n  endloop\n endfacet\nendsolid a\n";

    fn binary(header: &str, stated: u32, triangles: usize) -> Vec<u8> {
        let mut bytes = format!("{header:<80}").into_bytes();
        bytes.extend(stated.to_le_bytes());
        for k in 0..triangles {
            let corners = [
                0.0, 0.0, 1.0, k as f32, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 4.0, 0.0_f32,
            ];
            corners.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
            bytes.extend([0, 0]);
        }
        bytes
    }

    #[test]
    fn text_is_read_as_programs_write_it() {
        let one = Stl::parse(ONE.as_bytes()).unwrap();
        assert_eq!((one.points.len(), one.triangles.len()), (3, 1));
        let same = |name: &str, text: String| {
            let found = Stl::parse(text.as_bytes()).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(
                (found.points, found.triangles),
                (one.points.clone(), one.triangles.clone()),
                "{name}"
            );
        };
        same("no name", ONE.replace("solid a", "solid"));
        same("capitals", ONE.to_uppercase());
        same("tabs", ONE.replace(' ', "\t"));
        same("CR LF", ONE.replace('\n', "\r\n"));
        same("CR", ONE.replace('\n', "\r"));
        same("byte order mark and blank line", format!("\u{feff}\n{ONE}"));
        same(
            "a name of words of the format",
            ONE.replace("solid a", "solid facet vertex"),
        );
        same(
            "exponents",
            ONE.replace("vertex 4 0 0", "vertex 4.0E+00 0e0 +0.0"),
        );
        let two = ONE.to_owned() + &ONE.replace("vertex 0 0 0", "vertex 100 0 0");
        let two = Stl::parse(two.as_bytes()).unwrap();
        assert_eq!(
            (two.points.len(), two.triangles.len()),
            (4, 2),
            "several solids are one surface"
        );
    }

    #[test]
    fn binary_is_told_by_its_length() {
        for header in ["made by a scanner", "solid cube exported by CAD"] {
            let found = Stl::parse(&binary(header, 3, 3)).unwrap();
            assert_eq!(
                (found.triangles.len(), found.notes.len()),
                (3, 0),
                "{header}"
            );
        }
        let longer = [binary("x", 2, 2), vec![7; 9]].concat();
        assert_eq!(Stl::parse(&longer).unwrap().notes.len(), 1);
    }

    #[test]
    fn what_is_cut_off_or_foreign_is_named() {
        let cut = ONE.replace("endsolid a\n", "");
        let text = |text: &str| text.as_bytes().to_vec();
        for (name, bytes, says) in [
            ("empty", Vec::new(), "empty file"),
            ("short", vec![1, 2, 3], "3 other bytes"),
            ("no end", text(&cut), "cut off"),
            (
                "half a facet",
                text(&cut.replace(" endfacet\n", "")),
                "cut off",
            ),
            (
                "two corners",
                text(&ONE.replace("   vertex 4 0 0\n", "")),
                "three vertices",
            ),
            (
                "four corners",
                text(&ONE.replace("  endloop", "   vertex 9 9 9\n  endloop")),
                "three vertices",
            ),
            (
                "decimal commas",
                text(&ONE.replace("4 0 0", "4,0 0,0 0,0")),
                "line 5: expected vertex",
            ),
            (
                "another line",
                text(&ONE.replace(" facet", " colour 1\n facet")),
                "facet or endsolid",
            ),
            (
                "fewer than stated",
                binary("solid x", 3, 2),
                "expected 3 triangles as the header states, found 2",
            ),
            (
                "far more than there are",
                binary("x", u32::MAX, 2),
                "at most 1000000",
            ),
            (
                "UTF-16",
                ONE.encode_utf16().flat_map(u16::to_le_bytes).collect(),
                "triangles",
            ),
        ] {
            let error = Stl::parse(&bytes).unwrap_err();
            assert!(error.contains(says), "{name}: {error}");
        }
    }
}
