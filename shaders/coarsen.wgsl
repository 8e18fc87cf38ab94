// Stage active_cells, levels 1 and up: piecewise-constant aggregation of 2x2x2 cells. A coarse face weight is half the sum of
// the 4 fine ones, the free-surface term half the sum of the 8: the half is the over-correction 2 of constant prolongation
// (Braess 1995; Shao et al. 2022), here in the operator.
// fine, coarse: the levels. flags, matrix: all levels; the coarse one is written.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> fine: Level;
@group(0) @binding(1) var<uniform> coarse: Level;
@group(0) @binding(2) var<storage, read_write> flags: array<u32>;
@group(0) @binding(3) var<storage, read_write> matrix: array<Real4>;

// First of the two fine quads under a coarse quad, in the fine row (j, k), from the start of the arrays.
fn fine_quad(cell: vec3<u32>, j: u32, k: u32) -> u32 {
    let s = fine.shape;
    return s.first + s.stride_z * (2u * cell.z + k + 1u) + s.stride_y * (2u * cell.y + j) + cell.x / 2u;
}

fn even(a: Real4, b: Real4) -> Real4 {
    return Real4(a.x, a.z, b.x, b.z);
}

fn pairs(a: Real4, b: Real4) -> Real4 {
    return Real4(a.x + a.y, a.z + a.w, b.x + b.y, b.z + b.w);
}

@compute @workgroup_size(WG_SIZE)
fn coarsen(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let quad = linear_index(workgroup, lane) + coarse.shape.stride_z;
    if quad + 2u * coarse.shape.stride_z >= coarse.shape.quads {
        return;
    }
    let signed_cell = quad_cell(coarse.shape, quad);
    if any(signed_cell < vec3<i32>()) || any(vec3<u32>(signed_cell) >= coarse.shape.cells) {
        return;
    }
    let cell = vec3<u32>(signed_cell);
    // A fine row past the domain is the spare one, which holds zeros.
    var mask = 0u;
    for (var k = 0u; k < 2u; k++) {
        for (var j = 0u; j < 2u; j++) {
            let f = fine_quad(cell, j, k);
            let bits = (flags[f] & 15u) | ((flags[f + 1u] & 15u) << 4u);
            mask |= bits | (bits >> 1u);
        }
    }
    // Bits 0, 2, 4, 6: whether any of the 8 children of the four coarse cells is active.
    let flag = (mask & 1u) | ((mask >> 1u) & 2u) | ((mask >> 2u) & 4u) | ((mask >> 3u) & 8u);
    if flag == 0u {
        return;
    }
    let total = fine.shape.total;
    var wx = Real4();
    var wxp = Real4();
    var wy = Real4();
    var wyp = Real4();
    var wz = Real4();
    var wzp = Real4();
    var surface = Real4();
    for (var k = 0u; k < 2u; k++) {
        for (var j = 0u; j < 2u; j++) {
            let f = fine_quad(cell, j, k);
            let a = matrix[f];
            let b = matrix[f + 1u];
            wx += even(a, b);
            wxp += Real4(a.z, b.x, b.z, matrix[f + 2u].x);
            let d = DIRICHLET * total + f;
            surface += pairs(matrix[d], matrix[d + 1u]);
        }
        let y = total + fine_quad(cell, 0u, k);
        wy += pairs(matrix[y], matrix[y + 1u]);
        let yp = y + 2u * fine.shape.stride_y;
        wyp += pairs(matrix[yp], matrix[yp + 1u]);
        let z = 2u * total + fine_quad(cell, k, 0u);
        wz += pairs(matrix[z], matrix[z + 1u]);
        let zp = z + 2u * fine.shape.stride_z;
        wzp += pairs(matrix[zp], matrix[zp + 1u]);
    }
    let half = Real(0.5);
    wx *= half;
    wxp *= half;
    wy *= half;
    wyp *= half;
    wz *= half;
    wzp *= half;
    surface *= half;
    let diagonal = surface + ((wx + wxp) + (wy + wyp)) + (wz + wzp);
    let q = coarse.shape.first + quad;
    matrix[q] = wx;
    matrix[total + q] = wy;
    matrix[2u * total + q] = wz;
    matrix[DIRICHLET * total + q] = surface;
    matrix[INV_DIAGONAL * total + q] =
        select(Real4(), Real4(Real(1.0)) / max(diagonal, Real4(Real(1e-30))), diagonal > Real4());
    let c = Real4(Real(coarse.coefficient));
    let same = all(surface == Real4()) && all(wx == c) && all(wxp == c) && all(wy == c) && all(wyp == c)
        && all(wz == c) && all(wzp == c);
    flags[q] = flag | select(0u, UNIFORM, same);
}
