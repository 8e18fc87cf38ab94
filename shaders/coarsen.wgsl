// Stage active_cells, levels 1 and up: piecewise constant aggregation of 2x2x2 cells.
// A coarse face weight is half the sum of the 4 fine ones, the free-surface term half the sum of the 8. The half is
// the over-correction by 2 of constant prolongation (Braess 1995; Shao et al. 2022), applied to the operator.
// One thread per active fine quad; the first of those under a coarse quad writes it.
// fine, coarse: the levels. list, args: active quads of the fine level. flags, matrix: all levels; the coarse one is
// written.
#import dispatch
#import level
#import real

@group(0) @binding(0) var<uniform> fine: Level;
@group(0) @binding(1) var<uniform> coarse: Level;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read_write> flags: array<u32>;
@group(0) @binding(5) var<storage, read_write> matrix: array<Real4>;

const NONE = 0xffffffffu;

// First of the two fine quads under a coarse quad in the fine row (j, k), from the start of the arrays.
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
    let ix = linear_index(workgroup, lane);
    if ix >= args[fine.args + 3u] {
        return;
    }
    let own = list[fine.shape.first + ix] & ~UNIFORM;
    let fine_cell = vec3<u32>(quad_cell(fine.shape, own - fine.shape.first));
    // Cell of the first lane of the coarse quad, which covers two fine ones along each axis.
    let cell = vec3<u32>(4u * (fine_cell.x / 8u), fine_cell.yz / 2u);
    // A fine row beyond the domain is the spare one, which contains zeros.
    var mask = 0u;
    var first = NONE;
    for (var k = 0u; k < 2u; k++) {
        for (var j = 0u; j < 2u; j++) {
            let f = fine_quad(cell, j, k);
            let low = flags[f] & 15u;
            let high = flags[f + 1u] & 15u;
            first = min(first, min(select(NONE, f, low != 0u), select(NONE, f + 1u, high != 0u)));
            let bits = low | (high << 4u);
            mask |= bits | (bits >> 1u);
        }
    }
    if first != own {
        return;
    }
    // Bits 0, 2, 4, 6: whether any of the 8 children of the four coarse cells is active.
    let flag = (mask & 1u) | ((mask >> 1u) & 2u) | ((mask >> 2u) & 4u) | ((mask >> 3u) & 8u);
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
    let s = coarse.shape;
    let q = s.first + s.stride_z * (cell.z + 1u) + s.stride_y * cell.y + cell.x / 4u;
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
