//! `report.html` of `stereo-shape`: one self-contained file with the pictures and what was found drawn on them, the residuals
//! along the wire, and the shapes in space, which a person can turn. Nothing is computed here and nothing is loaded from a network.

use crate::document::StereoCameras;
use crate::error::VisionError;
use crate::pair_fit::PairFit;
use crate::picture::Picture;
use crate::shapes_document::{PairDocument, ShapesDocument};
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use nalgebra::{Point3, Vector2, Vector3};
use std::fmt::Write;

/// Quality of the pictures' JPEG: they are for looking at.
const JPEG_QUALITY: u8 = 80;

/// The drawn pictures and residuals of one pair, as HTML.
///
/// # Errors
/// Where a picture cannot be encoded.
pub fn pair_section(
    pictures: &[Picture; 2],
    stereo: &StereoCameras,
    fit: &PairFit,
    pair: &PairDocument,
) -> Result<String, VisionError> {
    let mut html = format!("<section><h2>{}</h2>{}<div class=\"two\">", escaped(&pair.name), facts(pair));
    for (camera, side) in ["left", "right"].into_iter().enumerate() {
        let picture = &pictures[camera];
        let _ = write!(
            html,
            "<figure><svg viewBox=\"-0.5 -0.5 {} {}\" role=\"img\" aria-label=\"{side} picture with the fitted wire\">\
             <image x=\"-0.5\" y=\"-0.5\" width=\"{}\" height=\"{}\" href=\"data:image/jpeg;base64,{}\"/>{}</svg>\
             <figcaption>{side}</figcaption></figure>",
            picture.width,
            picture.height,
            picture.width,
            picture.height,
            BASE64.encode(jpeg(picture)?),
            drawing(camera, stereo, fit, pair)
        );
    }
    let _ = write!(html, "</div>{}</section>", residuals(fit, pair.length_mm));
    Ok(html)
}

/// The whole page from the sections of the pairs that could be used.
#[must_use]
pub fn page(document: &ShapesDocument, sections: &[String]) -> String {
    let rejected: String = document
        .pairs
        .iter()
        .filter(|p| p.status != "ok")
        .map(|p| format!("<tr><td>{}</td><td>{}</td></tr>", escaped(&p.name), escaped(&p.why)))
        .collect();
    let rejected = if rejected.is_empty() {
        String::new()
    } else {
        format!("<h2>Rejected pairs</h2><table><tr><th>pair</th><th>why</th></tr>{rejected}</table>")
    };
    let warnings: String =
        document.warnings.iter().map(|w| format!("<p class=\"warning\">{}</p>", escaped(w))).collect();
    let good = document.pairs.iter().filter(|p| p.status == "ok").count();
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Whisker shapes</title><style>{STYLE}</style>\
         <h1>Whisker shapes from stereo pictures</h1><p>{good} of {} pairs used.</p>{warnings}\
         <h2>In space</h2><p>Base frame, mm. Drag to turn, wheel to zoom.</p><canvas id=\"space\" width=\"900\" height=\"520\"></canvas>\
         <p id=\"names\"></p>{rejected}{}<script>const pairs={};{SCRIPT}</script></html>\n",
        document.pairs.len(),
        sections.concat(),
        curves(document)
    )
}

fn facts(pair: &PairDocument) -> String {
    let sd = pair.centreline_sd_mm.iter().fold(0.0f64, |a, b| a.max(*b));
    let mut html = format!(
        "<p>Length {:.3} &plusmn; {:.3} mm, greatest sd across the wire {sd:.4} mm, residuals {:.3} px left, {:.3} px right.",
        pair.length_mm, pair.length_sd_mm, pair.residual_rms_px[0], pair.residual_rms_px[1]
    );
    if let Some(g) = &pair.groove {
        let _ = write!(
            html,
            " Contact \"{}\" at {:.3} &plusmn; {:.3} mm, {:.3} mm from the vertex that the rig tag states.",
            escaped(&g.contact),
            g.contact_arclength_mm,
            g.contact_arclength_sd_mm,
            g.distance_from_vertex_mm
        );
    }
    html.push_str("</p>");
    for gap in &pair.gaps {
        let _ = write!(
            html,
            "<p>Not seen from {:.1} to {:.1} mm ({}).</p>",
            gap.from_mm,
            gap.to_mm,
            gap.hidden_in.join(", ")
        );
    }
    for w in &pair.warnings {
        let _ = write!(html, "<p class=\"warning\">{}</p>", escaped(w));
    }
    html
}

/// Curve, measured pieces, tags and groove, in pixels.
fn drawing(camera: usize, stereo: &StereoCameras, fit: &PairFit, pair: &PairDocument) -> String {
    let project = |p: &Vector3<f64>| {
        let left = fit.left_from_base * Point3::from(*p);
        let x = if camera == 1 { stereo.right_from_left * left } else { left };
        stereo.cameras[camera].project(&x.coords)
    };
    let mut svg = String::new();
    let mut polygon = |points: &mut dyn Iterator<Item = Vector2<f64>>, class: &str, closed: bool| {
        let text: Vec<String> = points.map(|p| format!("{:.2},{:.2}", p.x, p.y)).collect();
        let name = if closed { "polygon" } else { "polyline" };
        let _ = write!(svg, "<{name} class=\"{class}\" points=\"{}\"/>", text.join(" "));
    };
    let side = if camera == 0 { "left" } else { "right" };
    for tag in pair.tags.iter().filter(|t| t.camera == side) {
        polygon(&mut tag.corners_px.iter().map(|c| Vector2::new(c[0], c[1])), "tag", true);
    }
    polygon(&mut pair.centreline_mm.iter().filter_map(|p| project(&Vector3::from(*p))), "curve", false);
    let (pieces, seen) = &fit.pieces[camera];
    for (piece, seen) in pieces.iter().zip(seen) {
        let at = piece.station.position_px + piece.station.normal() * piece.offset_px;
        let class = if *seen { "seen" } else { "unseen" };
        let _ = write!(svg, "<circle class=\"{class}\" cx=\"{:.2}\" cy=\"{:.2}\" r=\"0.8\"/>", at.x, at.y);
    }
    if let Some(p) = pair.groove.as_ref().and_then(|g| project(&Vector3::from(g.position_mm))) {
        let _ = write!(svg, "<circle class=\"groove\" cx=\"{:.2}\" cy=\"{:.2}\" r=\"6\"/>", p.x, p.y);
    }
    svg
}

/// Distance of every measured piece from the reprojected curve over the arc length.
fn residuals(fit: &PairFit, length_mm: f64) -> String {
    const WIDE: f64 = 900.0;
    const HIGH: f64 = 120.0;
    let most = fit.system.residuals_px.iter().filter(|r| r.is_finite()).fold(0.05f64, |m, r| m.max(r.abs()));
    let mut svg = format!(
        "<figure><svg class=\"plot\" viewBox=\"0 0 {WIDE} {HIGH}\" role=\"img\" aria-label=\"residuals along the wire\">\
         <line x1=\"0\" x2=\"{WIDE}\" y1=\"{}\" y2=\"{}\"/>",
        HIGH / 2.0,
        HIGH / 2.0
    );
    for (sight, r) in fit.sights.iter().zip(&fit.system.residuals_px).filter(|(_, r)| r.is_finite()) {
        let (x, y) = (WIDE * sight.arc_mm / length_mm.max(1e-9), HIGH / 2.0 * (1.0 - r / most));
        let side = ["left", "right"][sight.camera];
        let _ = write!(svg, "<circle class=\"{side}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2\"/>");
    }
    let _ = write!(
        svg,
        "</svg><figcaption>Measured pieces from the reprojected curve, root to tip; left blue, right red; full height &plusmn; {most:.3} px</figcaption></figure>"
    );
    svg
}

/// Curves and contacts for the view in space.
fn curves(document: &ShapesDocument) -> serde_json::Value {
    let used = document.pairs.iter().filter(|p| p.status == "ok");
    used.map(|p| {
        serde_json::json!({
            "name": escaped(&p.name),
            "line": p.centreline_mm,
            "groove": p.groove.as_ref().map(|g| g.position_mm),
        })
    })
    .collect()
}

fn jpeg(picture: &Picture) -> Result<Vec<u8>, VisionError> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width as u32, picture.height as u32);
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode(&picture.data, width, height, ExtendedColorType::L8)
        .map_err(VisionError::encoding("a picture for the report"))?;
    Ok(bytes)
}

/// Text within HTML; also keeps `</script>` out of a name.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

const STYLE: &str = "body{font:15px/1.4 system-ui,sans-serif;margin:2rem auto;max-width:1400px;padding:0 1rem;color:#1b1b1b}\
.two{display:grid;grid-template-columns:1fr 1fr;gap:1rem}figure{margin:0}svg{width:100%;height:auto;background:#eee}\
canvas{width:100%;max-width:900px;border:1px solid #bbb;touch-action:none;cursor:grab}\
.curve{fill:none;stroke:#19c319;stroke-width:.6}.seen{fill:#1667d9}.unseen{fill:#d92020}.tag{fill:none;stroke:#d916c0;stroke-width:1}\
.groove{fill:none;stroke:#e09a00;stroke-width:1.5}.plot{background:#fafafa;border:1px solid #ddd}.plot line{stroke:#999}\
.left{fill:#1667d9}.right{fill:#d92020}.warning{background:#fff3cd;padding:.4rem .6rem}table{border-collapse:collapse}\
td,th{border:1px solid #ccc;padding:.25rem .5rem;text-align:left}label{margin-right:1rem}";

const SCRIPT: &str = r##"
const canvas=document.getElementById("space"),pen=canvas.getContext("2d");
const colours=["#1667d9","#d92020","#1a8f3c","#a01fc4","#c77700","#0a8c99","#6b4f2a","#444"];
const shown=pairs.map(()=>true),all=pairs.flatMap(p=>p.line);
const middle=[0,1,2].map(k=>{const v=all.map(p=>p[k]);return v.length?(Math.min(...v)+Math.max(...v))/2:0});
let yaw=-.6,pitch=.5,scale=9,from=null;
function place(p){const [x,y,z]=p.map((v,k)=>v-middle[k]),c=Math.cos(yaw),s=Math.sin(yaw),C=Math.cos(pitch),S=Math.sin(pitch);
const a=c*x-s*y,b=s*x+c*y;return [canvas.width/2+scale*a,canvas.height/2-scale*(C*z+S*b)]}
function stroke(points,colour,width){pen.strokeStyle=colour;pen.lineWidth=width;pen.beginPath();
points.map(place).forEach((q,k)=>k?pen.lineTo(...q):pen.moveTo(...q));pen.stroke()}
function draw(){pen.clearRect(0,0,canvas.width,canvas.height);
[["x",[10,0,0]],["y",[0,10,0]],["z",[0,0,10]]].forEach(([n,p])=>{stroke([[0,0,0],p],"#888",1);pen.fillStyle="#555";pen.fillText(n+" 10 mm",...place(p))});
pairs.forEach((p,k)=>{if(!shown[k])return;const colour=colours[k%colours.length];stroke(p.line,colour,2);
if(p.groove){const q=place(p.groove);pen.fillStyle=colour;pen.beginPath();pen.arc(q[0],q[1],5,0,7);pen.fill()}})}
canvas.onpointerdown=e=>{from=[e.clientX,e.clientY];canvas.setPointerCapture(e.pointerId)};
canvas.onpointerup=()=>{from=null};
canvas.onpointermove=e=>{if(!from)return;yaw+=(e.clientX-from[0])*.008;pitch+=(e.clientY-from[1])*.008;from=[e.clientX,e.clientY];draw()};
canvas.onwheel=e=>{e.preventDefault();scale*=Math.exp(-e.deltaY*.001);draw()};
const names=document.getElementById("names");
pairs.forEach((p,k)=>{const l=document.createElement("label"),b=document.createElement("input");b.type="checkbox";b.checked=true;
b.onchange=()=>{shown[k]=b.checked;draw()};l.style.color=colours[k%colours.length];l.append(b," ");l.insertAdjacentHTML("beforeend",p.name);names.append(l)});
draw();
"##;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_self_contained_and_names_do_not_break_it() {
        let pair = PairDocument {
            name: "</script><b>".into(),
            status: "rejected".into(),
            why: "no <wire>".into(),
            ..PairDocument::default()
        };
        let good = PairDocument {
            name: "t1".into(),
            status: "ok".into(),
            centreline_mm: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]],
            ..PairDocument::default()
        };
        let html = page(&ShapesDocument { pairs: vec![pair, good], ..ShapesDocument::default() }, &[]);
        assert!(
            html.contains("1 of 2 pairs")
                && html.contains("no &lt;wire&gt;")
                && html.contains("[1.0,0.0,0.5]")
        );
        assert_eq!(html.matches("</script>").count(), 1);
        assert!(!html.contains("://"), "nothing is loaded from elsewhere");
    }
}
