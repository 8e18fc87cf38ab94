// solve with separation, first: the lanes that may separate, and those that do at the start: what separated in the last
// sub-step. A cell may where a face is not all open and its component has a free surface; with from_air also only beside air or a
// cell that separated before, among the 26 neighbours that open faces lead to, one axis after another.
// Growing, in later rounds: more lanes may, beside the separated ones.
// One thread per active quad.
// level. settings: from_air. args, list, flags: active quads (see active). open: apertures for the pressure. separated_before:
// see separation, of the last sub-step. separated: zero; out. Growing: flags without separated lanes; separated in place.
#import active
#import dispatch
#import face_index
#import layout
#import lanes
#import separation

struct SeparationSettings {
    // 0 or 1
    from_air: u32,
    // 0 or 1
    grows: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> settings: SeparationSettings;
@group(0) @binding(2) var<storage, read> args: array<u32>;
@group(0) @binding(3) var<storage, read> list: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> open: array<f32>;
@group(0) @binding(6) var<storage, read> separated_before: array<u32>;
@group(0) @binding(7) var<storage, read_write> separated: array<u32>;

// Whether a cell inside the domain has air, or separated before.
fn airy(cell: vec3<i32>) -> bool {
    let c = vec3<u32>(cell);
    let quad = cell_index(level, c) / 4u;
    let lane = c.x % 4u;
    return (flags[quad] >> lane & 1u) == 0u || (separated_before[quad] >> lane & 1u) == 1u;
}

// Whether the face between a cell and the next one along an axis is open. step: 1 or -1.
fn opens(cell: vec3<i32>, axis: u32, step: i32) -> bool {
    return open[face_index(axis, cell + max(step, 0) * along(axis))] > 0.0;
}

fn inside(cell: vec3<i32>) -> bool {
    return all(cell >= vec3<i32>()) && all(cell < vec3<i32>(level.cells));
}

fn beside_air(cell: vec3<i32>) -> bool {
    for (var number = 0; number < 27; number++) {
        let d = vec3<i32>(number % 3, number / 3 % 3, number / 9) - 1;
        // Bit m: whether open faces lead to the cell that differs along the axes in m.
        var reached = 1u;
        for (var m = 1u; m < 8u; m++) {
            let moves = vec3<bool>((m & 1u) != 0u, (m & 2u) != 0u, (m & 4u) != 0u);
            if any(moves & (d == vec3<i32>())) {
                continue;
            }
            for (var axis = 0u; axis < 3u; axis++) {
                let rest = m ^ (1u << axis);
                if !moves[axis] || (reached >> rest & 1u) == 0u {
                    continue;
                }
                let at = cell + select(vec3<i32>(), d, moves) - d[axis] * along(axis);
                if !inside(at) || !opens(at, axis, d[axis]) {
                    continue;
                }
                reached |= 1u << m;
                let next = at + d[axis] * along(axis);
                // Beyond an open side of the domain is air; from the cell itself alone.
                if !inside(next) {
                    if rest == 0u {
                        return true;
                    }
                } else if airy(next) {
                    return true;
                }
            }
        }
    }
    return airy(cell);
}

// Whether a face of a cell lies on an open side of the domain.
fn at_open_side(cell: vec3<i32>) -> bool {
    for (var axis = 0u; axis < 3u; axis++) {
        let first = cell[axis] == 0 && opens(cell, axis, -1);
        let last = cell[axis] + 1 == i32(level.cells[axis]) && opens(cell, axis, 1);
        if first || last {
            return true;
        }
    }
    return false;
}

// Lanes with air in or beside them, whatever the apertures: they include all lanes beside air in the domain. cell: of the first lane.
fn lanes_near_air(quad: u32, cell: vec3<i32>) -> u32 {
    // Bit l + 1: cells with air whose x is that of lane l.
    var air = 0u;
    for (var row = 0; row < 9; row++) {
        let d = vec3<i32>(0, row % 3 - 1, row / 3 - 1);
        if !inside(cell + d) {
            continue;
        }
        let at = cell_index(level, vec3<u32>(cell + d)) / 4u;
        air |= (~flags[at] & 15u | separated_before[at] & 15u) << 1u;
        if cell.x > 0 {
            air |= (~flags[at - 1u] | separated_before[at - 1u]) >> 3u & 1u;
        }
        if cell.x + 4 < i32(level.cells.x) {
            air |= ((~flags[at + 1u] | separated_before[at + 1u]) & 1u) << 5u;
        }
    }
    return air | air >> 1u | air >> 2u;
}

@compute @workgroup_size(WG_SIZE)
fn separation_start(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    let flag = flags[quad];
    var candidates = flag & (flag >> HELD) & ~(flag >> SURFACELESS) & 15u;
    if settings.from_air != 0u && candidates != 0u {
        let cell = quad_cell(level, quad);
        let near = lanes_near_air(quad, cell);
        for (var l = 0u; l < 4u; l++) {
            let at = cell + vec3<i32>(i32(l), 0, 0);
            if (candidates >> l & 1u) == 1u && !(((near >> l & 1u) == 1u || at_open_side(at)) && beside_air(at)) {
                candidates &= ~(1u << l);
            }
        }
    }
    if settings.grows != 0u {
        separated[quad] |= candidates << CANDIDATES;
        return;
    }
    let now = separated_before[quad] & candidates;
    separated[quad] = now | candidates << CANDIDATES | now << NEXT;
}
