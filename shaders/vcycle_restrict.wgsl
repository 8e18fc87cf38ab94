// V-cycle: the residual r - B x of a level, summed over the 8 children of each coarse cell, becomes the right-hand side of the
// next level; the coarse level's first sweep, from zero, is done on the way: x = omega D^-1 r.
// level: the fine level. coarse: the coarse level. sweep: the coarse level's first omega. list, args: active quads of the coarse
// level. matrix: see level. x: fine approximation in, and where the coarse one begins (coarse section of x_out). r: fine in, coarse out.
#import dispatch
#import stencil
#import sweep

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> coarse: Level;
@group(0) @binding(2) var<uniform> sweep: Sweep;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> args: array<u32>;
@group(0) @binding(5) var<storage, read> matrix: array<Inner4>;
@group(0) @binding(6) var<storage, read> x: array<Real4>;
@group(0) @binding(7) var<storage, read_write> r: array<Real4>;
@group(0) @binding(8) var<storage, read_write> x_out: array<Real4>;
@group(0) @binding(9) var<storage, read> flags: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn vcycle_restrict(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[coarse.args + 3u] {
        return;
    }
    let entry = list[coarse.shape.first + ix];
    let q = entry & ~UNIFORM;
    let cell = vec3<u32>(quad_cell(coarse.shape, q - coarse.shape.first));
    let s = level.shape;
    let corner = s.first + s.stride_z * (2u * cell.z + 1u) + s.stride_y * 2u * cell.y + cell.x / 2u;
    var sum = Real4();
    for (var child = 0u; child < 4u; child++) {
        let f = corner + (child & 1u) * s.stride_y + (child >> 1u) * s.stride_z;
        sum += Real4(pair_sums(f), pair_sums(f + 1u));
    }
    r[q] = sum;
    x_out[q] = Real(sweep.omega) * inv_diagonal(coarse, q, (entry & UNIFORM) != 0u) * sum;
}

// Residuals of a fine quad, added in pairs along x. Quads without liquid hold values of earlier steps and count for nothing.
fn pair_sums(f: u32) -> vec2<Real> {
    let flag = flags[f];
    if flag == 0u {
        return vec2<Real>();
    }
    let residual = r[f] - row_of(level, f, (flag & UNIFORM) != 0u).bx;
    return vec2<Real>(residual.x + residual.y, residual.z + residual.w);
}
