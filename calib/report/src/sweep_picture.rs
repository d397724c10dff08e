//! A sweep over an object in space: slices of the object, the wire, the contacts found and those of another method. From above (along z) and
//! obliquely: u = x cos a - y sin a, v = z cos b + (x sin a + y cos a) sin b.

use crate::plot::{Axis, Layer, Plot};
use crate::sections::{figure, legend, series};

/// What is drawn, world frame, mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SweepPicture {
    /// Segments of the slice of the object in the plane of the wire.
    pub slice_mm: Vec<[[f64; 3]; 2]>,
    /// Segments of slices above and below it.
    pub slices_mm: Vec<[[f64; 3]; 2]>,
    /// The wire.
    pub wire_mm: Vec<[f64; 3]>,
    /// Contacts with their name in the legend: first those found, then others.
    pub contacts_mm: Vec<(String, Vec<[f64; 3]>)>,
    /// Name of the wire in the legend.
    pub wire: String,
    /// Caption.
    pub caption: String,
    /// The data are simulated.
    pub simulated: bool,
}

/// Width and height of a view, SVG units; what axes and titles take of them.
const SIZE: [f64; 2] = [440.0, 330.0];
const AXES: [f64; 2] = [64.0, 62.0];
/// Turn and tilt of the oblique view, rad.
const OBLIQUE: [f64; 2] = [0.55, 0.5];
/// Space around what is drawn, mm.
const MARGIN_MM: f64 = 4.0;

fn above(p: &[f64; 3]) -> [f64; 2] {
    [p[0], p[1]]
}

fn oblique(p: &[f64; 3]) -> [f64; 2] {
    let [(s, c), (sin, cos)] = OBLIQUE.map(f64::sin_cos);
    [p[0] * c - p[1] * s, p[2] * cos + (p[0] * s + p[1] * c) * sin]
}

impl SweepPicture {
    /// Both views as a figure.
    #[must_use]
    pub fn html(&self) -> String {
        let names: Vec<String> =
            self.contacts_mm.iter().map(|c| c.0.clone()).chain([self.wire.clone()]).collect();
        let charts = [
            self.view("In the plane of the wire", ["x, mm", "y, mm"], above, &self.slice_mm),
            self.view("In space", ["across, mm", "up, mm (oblique)"], oblique, &self.slices_mm),
        ];
        figure(self.simulated, "pictures", &charts.concat(), &self.caption) + &legend(&names)
    }

    fn view(
        &self,
        title: &str,
        [x, y]: [&str; 2],
        place: fn(&[f64; 3]) -> [f64; 2],
        object: &[[[f64; 3]; 2]],
    ) -> String {
        let contacts = || self.contacts_mm.iter().flat_map(|c| &c.1);
        let shown: Vec<[f64; 2]> = contacts().chain(&self.wire_mm).map(place).collect();
        let [across, up] = equal_scales(&shown);
        let inside =
            |p: &[f64; 2]| (across[0]..=across[1]).contains(&p[0]) && (up[0]..=up[1]).contains(&p[1]);
        let mut outline = Vec::new();
        for [a, b] in object.iter().map(|s| [place(&s[0]), place(&s[1])]) {
            if inside(&a) && inside(&b) {
                outline.extend([a, b, [f64::NAN; 2]]);
            }
        }
        let mut layers = vec![Layer::Line { class: "quiet", at: outline }];
        let wire = series(self.contacts_mm.len()).0;
        layers.push(Layer::Line { class: wire, at: self.wire_mm.iter().map(place).collect() });
        // What was found lies over the others.
        for (k, (_, at)) in self.contacts_mm.iter().enumerate().rev() {
            let (class, marker) = series(k);
            layers.push(Layer::Points {
                class,
                marker,
                at: at.iter().map(place).collect(),
                titles: Vec::new(),
            });
        }
        Plot {
            title: title.to_owned(),
            description: self.caption.clone(),
            width: SIZE[0],
            height: SIZE[1],
            x: Axis::fixed(x, across[0], across[1]),
            y: Axis::fixed(y, up[0], up[1]),
            layers,
        }
        .svg()
    }
}

/// Ranges of both axes that hold the points at one scale.
fn equal_scales(points: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let range = |k: usize| {
        let low = points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = points.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        if low <= high { [low - MARGIN_MM, high + MARGIN_MM] } else { [-MARGIN_MM, MARGIN_MM] }
    };
    let ranges = [range(0), range(1)];
    let size = [0, 1].map(|k| SIZE[k] - AXES[k]);
    let scale = [0, 1].map(|k| (ranges[k][1] - ranges[k][0]) / size[k]).into_iter().fold(0.0, f64::max);
    [0, 1].map(|k| {
        let middle = 0.5 * (ranges[k][0] + ranges[k][1]);
        [middle - 0.5 * scale * size[k], middle + 0.5 * scale * size[k]]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_views_have_one_scale_and_every_contact() {
        let contacts: Vec<[f64; 3]> = (0..5).map(|k| [10.0 * f64::from(k), 0.0, 1.0]).collect();
        let picture = SweepPicture {
            contacts_mm: vec![("own".into(), contacts.clone()), ("others".into(), contacts)],
            wire: "wire".into(),
            wire_mm: vec![[0.0; 3], [0.0, 20.0, 0.0]],
            caption: "a sweep".into(),
            ..SweepPicture::default()
        };
        let html = picture.html();
        assert_eq!(html.matches("<svg").count(), 2);
        assert!(html.contains("own") && html.contains("others") && !html.contains("SIMULATED"));
        let [x, y] = equal_scales(&[[0.0, 0.0], [40.0, 20.0]]);
        let scale = |r: [f64; 2], k: usize| (r[1] - r[0]) / (SIZE[k] - AXES[k]);
        assert!((scale(x, 0) - scale(y, 1)).abs() < 1e-12 && x[0] < -3.999 && x[1] > 43.999, "{x:?} {y:?}");
        // Control: simulated data are marked.
        assert!(SweepPicture { simulated: true, ..picture }.html().contains("SIMULATED"));
    }
}
