// V-cycle: the levels of at most TAIL_QUADS quads, where a dispatch costs more than its work, in one workgroup, a thread per quad: the
// same sweeps, restrictions and prolongations as the other vcycle kernels, in place behind barriers, as a list of steps. The list
// ends the descent by sweeping the last level until it counts as solved. One loop over steps, not one call after another: drivers
// inline every call, and one of them took 20 s to compile that.
// tail: levels and steps. flags, matrix: all levels. r: right-hand side of the tail's first level in, those of the others out.
// x_in: first sweep of the tail's first level. x: its correction, out.
#import dispatch
#import stencil

// Must be solver::TAIL_LEVELS, TAIL_STEPS and TAIL_QUADS.
const TAIL_LEVELS = 8u;
const TAIL_STEPS = 48u;
const TAIL_QUADS = 256u;

const SWEEP = 0u;
// to the level from the next finer one, with the first sweep from zero
const RESTRICT = 1u;
// to the level from the next coarser one
const PROLONG = 2u;

struct Step {
    op: u32,
    level: u32,
    omega: f32,
    pad_0: u32,
}

struct Tail {
    levels: array<Level, TAIL_LEVELS>,
    steps: array<Step, TAIL_STEPS>,
    n_steps: u32,
    pad_0: u32,
    pad_1: u32,
    pad_2: u32,
}

@group(0) @binding(0) var<uniform> tail: Tail;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(3) var<storage, read_write> r: array<Real4>;
@group(0) @binding(4) var<storage, read> x_in: array<Real4>;
@group(0) @binding(5) var<storage, read_write> x: array<Real4>;

fn residual_sums(finer: Level, quad: u32, coarser: Level) -> Real4 {
    let cell = vec3<u32>(quad_cell(coarser.shape, quad));
    let s = finer.shape;
    let corner = s.first + s.stride_z * (2u * cell.z + 1u) + s.stride_y * 2u * cell.y + cell.x / 2u;
    var sum = Real4();
    for (var child = 0u; child < 8u; child++) {
        let f = corner + (child & 1u) + ((child >> 1u) & 1u) * s.stride_y + (child >> 2u) * s.stride_z;
        if flags[f] != 0u {
            let residual = r[f] - row_of(finer, f, false).bx;
            let pairs = residual.xz + residual.yw;
            sum += select(Real4(pairs, Real(0.0), Real(0.0)), Real4(Real(0.0), Real(0.0), pairs), (child & 1u) == 1u);
        }
    }
    return sum;
}

@compute @workgroup_size(TAIL_QUADS)
fn vcycle_tail(@builtin(local_invocation_index) quad: u32) {
    let top = tail.levels[0].shape;
    if quad < top.quads {
        x[top.first + quad] = x_in[top.first + quad];
    }
    storageBarrier();
    workgroupBarrier();
    for (var s = 0u; s < tail.n_steps; s++) {
        let step = tail.steps[s];
        let level = tail.levels[step.level];
        let q = level.shape.first + quad;
        let works = quad < level.shape.quads && flags[q] != 0u;
        var value = Real4();
        if works {
            if step.op == SWEEP {
                let row = row_of(level, q, false);
                value = row.x + Real(step.omega) * inv_diagonal(level, q, false) * (r[q] - row.bx);
            } else if step.op == RESTRICT {
                let sum = residual_sums(tail.levels[step.level - 1u], quad, level);
                r[q] = sum;
                value = Real(step.omega) * inv_diagonal(level, q, false) * sum;
            } else {
                let cell = vec3<u32>(quad_cell(level.shape, quad));
                let coarser = tail.levels[step.level + 1u].shape;
                let above = x[coarser.first + coarser.stride_z * (cell.z / 2u + 1u) + coarser.stride_y * (cell.y / 2u)
                    + cell.x / 8u];
                value = x[q] + select(above.xxyy, above.zzww, (cell.x & 4u) != 0u);
            }
        }
        storageBarrier();
        workgroupBarrier();
        if works {
            x[q] = value;
        }
        storageBarrier();
        workgroupBarrier();
    }
}
