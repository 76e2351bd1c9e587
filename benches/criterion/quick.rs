//! quick
use geomag_core::{grid::*, lattice::*, matching::similarity::Msd, monitor::Quiet};
fn main() {
    let n = 2000;
    let x: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let v: Vec<f64> = (0..n * n).map(|i| ((i * 7919) % 1000) as f64).collect();
    for f in [false, true] {
        let vals = if f { GridValues::F32(v.iter().map(|&a| a as f32).collect()) } else { GridValues::F64(v.clone()) };
        let g = GridMap::new(vals, &x, &x, false).unwrap();
        let lat = OffsetLattice::new([500.0; 2], [1.0; 2], 1 << 30).unwrap();
        let pts: Vec<[f64; 2]> = (0..100).map(|k| [700.3 + 5.1 * k as f64, 800.2 + 3.3 * k as f64]).collect();
        let vv: Vec<f64> = pts.iter().map(|p| g.sample(p[0], p[1], Interpolation::Bilinear)).collect();
        let c = Comparison::new(&g, lat, pts, vv, None, Interpolation::Bilinear, 100).unwrap();
        for _ in 0..4 {
            let t = std::time::Instant::now();
            let s = c.scores(Msd, 0..1001, 0..1001, &Quiet).unwrap();
            let dt = t.elapsed().as_secs_f64();
            println!(
                "f32 {f} {:.1} ms, {:.3} ns/offset-sample wall; min {:?}",
                dt * 1e3,
                dt * 1e9 / 1001.0 / 1001.0 / 100.0,
                s[500 * 1001 + 500]
            );
        }
    }
}
