//! Rays a second of the ray kernel on a mesh and a file of rays, to be set beside other kernels.
//!
//! `cargo run --release --example ray_rate -- MESH.plm RAYS.plr [--threads N] [--reps N] [--portable]
//! [--hits OUT.plh]`. Prints one line of JSON: rays a second by the clock and by CPU time, best of
//! the repetitions, and what the build took. The formats (little endian):
//!
//! - mesh: `PLM1`, u32 vertices, u32 triangles, f32 x y z a vertex, u32 i j k a triangle
//! - rays: `PLR1`, u32 rays, u32 kind (0 nearest hit, 1 any hit), then 8 f32 a ray: origin, t_min,
//!   direction, t_max
//! - hits: `PLH1`, u32 rays, f32 t a ray (−1 miss; any hit: 0 blocked), u32 triangle a ray (any hit:
//!   1 blocked)
//!
//! `docs/bench/README.md` says how it is set against Embree.

mod cpu;

use std::error::Error;
use std::fs;
use std::time::Instant;

use clap::Parser;
use glam::Vec3;
use platelight::scene::Mesh;
use platelight::trace::{Accel, Ray};
use rayon::prelude::*;

#[derive(Parser)]
struct Args {
    mesh: String,
    rays: String,
    #[arg(long, default_value_t = 1)]
    threads: usize,
    #[arg(long, default_value_t = 5)]
    reps: usize,
    /// Without AVX2.
    #[arg(long)]
    portable: bool,
    /// Write what every ray hit.
    #[arg(long)]
    hits: Option<String>,
}

/// Rays that one thread takes at a time.
const CHUNK: usize = 4096;

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    if args.portable {
        platelight::trace::portable_only();
    }
    let mesh = read_mesh(&args.mesh)?;
    let (rays, any) = read_rays(&args.rays)?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build()?;
    pool.install(|| -> Result<(), String> {
        let (clock, cpu) = (Instant::now(), cpu::seconds());
        let accel = Accel::build(&[&mesh]);
        let (build_wall, build_cpu) = (clock.elapsed().as_secs_f64(), cpu::seconds() - cpu);

        let mut hits = vec![(-1.0_f32, u32::MAX); rays.len()];
        let (mut best_wall, mut best_cpu) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..args.reps {
            let (clock, cpu) = (Instant::now(), cpu::seconds());
            hits.par_chunks_mut(CHUNK).zip(rays.par_chunks(CHUNK)).for_each(|(hits, rays)| {
                for (hit, ray) in hits.iter_mut().zip(rays) {
                    *hit = if any {
                        let blocked = accel.occluded(ray);
                        (if blocked { 0.0 } else { -1.0 }, u32::from(blocked))
                    } else {
                        accel.closest(ray).map_or((-1.0, u32::MAX), |hit| (hit.t, hit.triangle))
                    };
                }
            });
            best_wall = best_wall.min(clock.elapsed().as_secs_f64());
            best_cpu = best_cpu.min(cpu::seconds() - cpu);
        }
        let n = rays.len() as f64;
        let hit = hits.iter().filter(|(t, _)| *t >= 0.0).count() as f64;
        let line = serde_json::json!({
            "kernel": format!("platelight {}", env!("CARGO_PKG_VERSION")),
            "tris": mesh.triangles.len(),
            "rays": rays.len(),
            "kind": if any { "any" } else { "closest" },
            "threads": args.threads,
            "hit_fraction": hit / n,
            "mrays_s_wall": 1e-6 * n / best_wall,
            "mrays_per_cpu_s": 1e-6 * n / best_cpu,
            "build_cpu_s": build_cpu,
            "build_wall_s": build_wall,
            "bytes_per_triangle": accel.n_bytes() as f64 / mesh.triangles.len() as f64,
        });
        println!("{line}");
        match &args.hits {
            Some(path) => write_hits(path, &hits).map_err(|e| format!("{path}: {e}")),
            None => Ok(()),
        }
    })?;
    Ok(())
}

/// Little-endian words of a file that opens with `magic`.
fn read_words(path: &str, magic: &[u8; 4]) -> Result<Vec<u32>, Box<dyn Error>> {
    let bytes = fs::read(path).map_err(|e| format!("{path}: {e}"))?;
    let rest = bytes
        .strip_prefix(magic)
        .ok_or_else(|| format!("{path}: does not begin with {magic:?}"))?;
    Ok(rest.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn read_mesh(path: &str) -> Result<Mesh, Box<dyn Error>> {
    let words = read_words(path, b"PLM1")?;
    let short = || format!("{path}: cut short");
    let [vertices, triangles] = *words.first_chunk().ok_or_else(short)?;
    let corners_from = 2 + 3 * vertices as usize;
    if words.len() != corners_from + 3 * triangles as usize {
        return Err(short().into());
    }
    let positions = words[2..corners_from].chunks_exact(3);
    let triangles = words[corners_from..].chunks_exact(3).map(|c| [c[0], c[1], c[2]]);
    let mesh = Mesh {
        positions: positions
            .map(|c| Vec3::from_array([0, 1, 2].map(|i| f32::from_bits(c[i]))))
            .collect(),
        triangles: triangles.collect(),
        ..Mesh::default()
    };
    let legal = mesh.triangles.iter().flatten().all(|&i| i < vertices);
    if legal { Ok(mesh) } else { Err(format!("{path}: a corner outside the vertices").into()) }
}

fn read_rays(path: &str) -> Result<(Vec<Ray>, bool), Box<dyn Error>> {
    let words = read_words(path, b"PLR1")?;
    let short = || format!("{path}: cut short");
    let [count, kind] = *words.first_chunk().ok_or_else(short)?;
    if words.len() != 2 + 8 * count as usize {
        return Err(short().into());
    }
    let rays = words[2..].chunks_exact(8).map(|ray| {
        let [ox, oy, oz, t_min, dx, dy, dz, t_max] =
            [0, 1, 2, 3, 4, 5, 6, 7].map(|i| f32::from_bits(ray[i]));
        Ray { origin: Vec3::new(ox, oy, oz), direction: Vec3::new(dx, dy, dz), t_min, t_max }
    });
    Ok((rays.collect(), kind == 1))
}

fn write_hits(path: &str, hits: &[(f32, u32)]) -> std::io::Result<()> {
    let mut bytes = b"PLH1".to_vec();
    bytes.extend((hits.len() as u32).to_le_bytes());
    bytes.extend(hits.iter().flat_map(|(t, _)| t.to_le_bytes()));
    bytes.extend(hits.iter().flat_map(|(_, id)| id.to_le_bytes()));
    fs::write(path, bytes)
}
