use nalgebra::Vector2;
use wcal_vision::{bundle::*, calibrate::*, chessboard::*, pairs::*, picture::*};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let board = BoardSize { columns: 9, rows: 6 };
    let square: f64 = a[3].parse().unwrap();
    let pairs = pair_files(&list_pictures(&a[1]).unwrap(), &list_pictures(&a[2]).unwrap()).unwrap();
    let pics: Vec<_> = pairs.iter().map(|p| (p.name.clone(), Picture::read(p.left.as_ref().unwrap()).unwrap(), Picture::read(p.right.as_ref().unwrap()).unwrap())).collect();
    let coarse: Vec<_> = pics.iter().map(|(n, l, r)| { let l = find_chessboard(l, board).unwrap(); let r = find_chessboard(r, board).unwrap(); println!("{n} {:?} {:?}", l.as_ref().map(|p| p[0]), r.as_ref().map(|p| p[0])); (l.unwrap(), r.unwrap()) }).collect();
    for (k, (l, r)) in coarse.iter().enumerate() { println!("{:?} {:?}", continues_beyond(&pics[k].1, board, l), continues_beyond(&pics[k].2, board, r)); }
    println!("noise {:?}", pics[0].1.noise_model());
    let points = board_points(9, 6, square);
    let size = [pics[0].1.width, pics[0].1.height];
    for how in [Refinement::Gradient(5), Refinement::Model(0.3), Refinement::Model(0.5), Refinement::Model(0.7)] {
        let t = std::time::Instant::now();
        let views: Vec<BoardView> = coarse.iter().zip(&pics).map(|((l, r), (n, pl, pr))| {
            let f = |p: &Picture, c: &Vec<Vector2<f64>>| refine(p, board, c, how).unwrap().into_iter().map(|c| c.map(|c| c.position_px)).collect::<Vec<_>>();
            BoardView { name: n.clone(), left: f(pl, l), right: f(pr, r) } }).collect();
        let tr = t.elapsed();
        let missing = views.iter().map(|v| v.left.iter().chain(&v.right).filter(|c| c.is_none()).count()).sum::<usize>();
        let t = std::time::Instant::now();
        match calibrate_stereo(&points, views, size) {
            Ok(s) => { let ts = t.elapsed(); let t2 = std::time::Instant::now(); let h = leave_one_out(&points, &s); println!("{how}: rms {:.4} warp {} {:?} base {:.5} miss {missing} worst {:.3} rej {:?} held {:.4} {:.4} refine {tr:?} solve {ts:?} loo {:?} fx {:.3}+-{:.3} {:?}", s.bundle.rms_px(), s.warp_used, s.bundle.state.warp, s.bundle.state.right_from_left.translation.vector.norm(), s.per_view_rms_px.iter().flatten().fold(0.0f64, |a, b| a.max(*b)), s.rejected, h.epipolar_mean_px, h.epipolar_p95_px, t2.elapsed(), s.bundle.state.cameras[0].focal_px[0], s.bundle.shared_covariance[(0,0)].sqrt(), s.warnings) }
            Err(e) => println!("{how}: {e}"),
        }
    }
}
