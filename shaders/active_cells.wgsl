// Stage active_cells, level 0: active cells and the matrix of the projection (ghost fluid, Gibou et al. 2002; thesis
// 4.43).
// A cell is active when its liquid distance is negative and one of its faces is open. The weight between active cells
// is the face aperture. The diagonal also includes aperture / theta towards air, and aperture / (1/2) on open sides
// of the domain.
// Only quads with liquid are written; all arrays are zero elsewhere. One thread per quad that may contain liquid.
// level: the level. settings: theta floors, whether sides are open. list, args: those quads. liquid_distance: per
// cell, m. open: apertures of the minus faces along x, y, z; closed where not above 0. flags: per quad, active and held
// lanes (see active) and UNIFORM. matrix: see level.
#import active
#import dispatch
#import level
#import real
#import ghost_fluid

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<uniform> settings: ActiveSettings;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> args: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> flags: array<u32>;
@group(0) @binding(7) var<storage, read_write> matrix: array<Real4>;

// The liquid distance in the neighbour cells of a quad, m.
struct Around {
    xm: vec4<f32>,
    xp: vec4<f32>,
    ym: vec4<f32>,
    yp: vec4<f32>,
    zm: vec4<f32>,
    zp: vec4<f32>,
}

// Beyond the sides of the domain the mirror image, so that the ghost fluid method places the surface in the plane of
// the side.
fn beyond_sides(around: Around, phi: vec4<f32>, cell: vec3<i32>) -> Around {
    let n = vec3<i32>(level.shape.cells);
    let lanes = vec4<i32>(cell.x) + vec4<i32>(0, 1, 2, 3);
    let low = vec3<bool>(false, cell.y == 0, cell.z == 0);
    let high = vec3<bool>(false, cell.y == n.y - 1, cell.z == n.z - 1);
    return Around(
        select(around.xm, -phi, lanes == vec4<i32>()), select(around.xp, -phi, lanes == vec4<i32>(n.x - 1)),
        select(around.ym, -phi, vec4<bool>(low.y)), select(around.yp, -phi, vec4<bool>(high.y)),
        select(around.zm, -phi, vec4<bool>(low.z)), select(around.zp, -phi, vec4<bool>(high.z)));
}

// Weight between two cells and free-surface term of the first, for one face per lane.
struct Face {
    weight: Real4,
    dirichlet: Real4,
}

fn face(inside: vec4<f32>, outside: vec4<f32>, area: vec4<f32>) -> Face {
    var out: Face;
    for (var l = 0; l < 4; l++) {
        if inside[l] < 0.0 && area[l] > 0.0 {
            if outside[l] < 0.0 {
                out.weight[l] = Real(area[l]);
            } else {
                let floor = face_theta_floor(settings, area[l]);
                out.dirichlet[l] = Real(area[l]) / Real(ghost_theta(inside[l], outside[l], floor));
            }
        }
    }
    return out;
}

@compute @workgroup_size(WG_SIZE)
fn active_cells(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= args[3] {
        return;
    }
    let q = list[ix];
    let sy = level.shape.stride_y;
    let sz = level.shape.stride_z;
    let phi = liquid_distance[q];
    if all(phi >= vec4<f32>(0.0)) {
        return;
    }
    let n = level.shape.quads;
    let ax = open[q];
    var around = Around(
        vec4<f32>(liquid_distance[q - 1u].w, phi.xyz), vec4<f32>(phi.yzw, liquid_distance[q + 1u].x),
        liquid_distance[q - sy], liquid_distance[q + sy], liquid_distance[q - sz], liquid_distance[q + sz]);
    if settings.open_sides != 0u {
        around = beyond_sides(around, phi, quad_cell(level.shape, q));
    }
    let bx = vec4<f32>(ax.yzw, open[q + 1u].x);
    let ay = open[n + q];
    let by = open[n + q + sy];
    let az = open[2u * n + q];
    let bz = open[2u * n + q + sz];
    let xm = face(phi, around.xm, ax);
    let xp = face(phi, around.xp, bx);
    let ym = face(phi, around.ym, ay);
    let yp = face(phi, around.yp, by);
    let zm = face(phi, around.zm, az);
    let zp = face(phi, around.zp, bz);
    let surface = ((xm.dirichlet + xp.dirichlet) + (ym.dirichlet + yp.dirichlet)) + (zm.dirichlet + zp.dirichlet);
    let diagonal = surface + ((xm.weight + xp.weight) + (ym.weight + yp.weight)) + (zm.weight + zp.weight);
    let active_lanes = diagonal > Real4();
    if !any(active_lanes) {
        return;
    }
    let total = level.shape.total;
    matrix[q] = xm.weight;
    matrix[total + q] = ym.weight;
    matrix[2u * total + q] = zm.weight;
    matrix[DIRICHLET * total + q] = surface;
    let one = Real4(Real(1.0));
    matrix[INV_DIAGONAL * total + q] = select(Real4(), one / max(diagonal, Real4(Real(1e-30))), active_lanes);
    let held = active_lanes & (min(min(min(ax, bx), min(ay, by)), min(az, bz)) < vec4<f32>(1.0));
    let lanes = dot(vec4<u32>(active_lanes), vec4<u32>(1u, 2u, 4u, 8u));
    var flag = lanes | dot(vec4<u32>(held), vec4<u32>(1u, 2u, 4u, 8u)) << HELD | lanes << FILLED;
    if all(surface == Real4())
        && all(xm.weight == one) && all(xp.weight == one) && all(ym.weight == one)
        && all(yp.weight == one) && all(zm.weight == one) && all(zp.weight == one) {
        flag |= UNIFORM;
    }
    flags[q] = flag;
}
