// marker_band, second of four: the sites that enter the band, where phi* < -3 <= phi, outside bodies, with phi* the level after its transport
// and phi the one after all changes. One thread per quad of the band.
// level, step. level_step: seed and sub-step. band_args, band_list: the band. carried_level: phi*, cell centres, cells. liquid_distance: dx phi,
// m. solid_distance: m; one quad in a scene without bodies. seeds: per quad of the list, a bit per site, eight per lane. chunks: their number per
// workgroup.
#import corner
#import dispatch
#import layout
#import lanes
#import step
#import sites
#import marker_depth

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> level_step: LevelStep;
@group(0) @binding(3) var<storage, read> band_args: array<u32>;
@group(0) @binding(4) var<storage, read> band_list: array<u32>;
@group(0) @binding(5) var<storage, read> carried_level: array<f32>;
@group(0) @binding(6) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(7) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(8) var<storage, read_write> seeds: array<u32>;
@group(0) @binding(9) var<storage, read_write> chunks: array<u32>;

// Levels of the cells that may contain such a site, cells: the level of a cell is within two cells of that of its sites.
const LOWEST = -5.0;
const HIGHEST = -1.0;
// Rounding of a mean of levels, cells.
const MARGIN = 1e-3;

var<workgroup> sh_seeds: atomic<u32>;

fn carried_at(place: Corner) -> f32 {
    let points = corner_points(place);
    let at = points[0];
    let next = points[1];
    let minus = vec4<f32>(carried_level[at.x], carried_level[at.y], carried_level[at.z], carried_level[at.w]);
    let plus = vec4<f32>(carried_level[next.x], carried_level[next.y], carried_level[next.z], carried_level[next.w]);
    return mix_points(minus, plus, place.f);
}

// Whether a place is outside bodies.
fn is_free(place: Corner) -> bool {
    if arrayLength(&solid_distance) <= 4u {
        return true;
    }
    let points = corner_points(place);
    let at = points[0];
    let next = points[1];
    let minus = vec4<f32>(solid_distance[at.x], solid_distance[at.y], solid_distance[at.z], solid_distance[at.w]);
    let plus = vec4<f32>(solid_distance[next.x], solid_distance[next.y], solid_distance[next.z], solid_distance[next.w]);
    return mix_points(minus, plus, place.f) >= 0.0;
}

// Lanes of the quad that starts at a cell where sites may enter: of the 27 cells around, some have phi* < -3, and some -3 <= phi. Those beyond a
// wall are those at the wall.
fn may_enter(cell: vec3<i32>) -> vec4<bool> {
    let top = vec3<i32>(level.cells) - 1;
    let low = vec2<u32>(max(cell.yz - 1, vec2<i32>()));
    let high = vec2<u32>(min(cell.yz + 1, top.yz));
    let x = u32(cell.x);
    let before = u32(max(cell.x - 1, 0));
    let lanes = min(vec4<u32>(x) + vec4<u32>(0u, 1u, 2u, 3u), vec4<u32>(u32(top.x)));
    let after = u32(min(cell.x + 4, top.x));
    var lowest = vec4<f32>();
    var highest = vec4<f32>(-2.0 * MARKER_DEPTH * step.dx);
    for (var z = low.y; z <= high.y; z++) {
        for (var y = low.x; y <= high.x; y++) {
            let row = 4u * (level.stride_z * (z + 1u) + level.stride_y * y);
            let at = row + lanes;
            let carried = vec4<f32>(carried_level[at.x], carried_level[at.y], carried_level[at.z], carried_level[at.w]);
            let carried_sides = vec2<f32>(carried_level[row + before], carried_level[row + after]);
            lowest = min(lowest, min(carried, min(vec4<f32>(carried_sides.x, carried.xyz), vec4<f32>(carried.yzw, carried_sides.y))));
            let now = vec4<f32>(liquid_distance[at.x], liquid_distance[at.y], liquid_distance[at.z], liquid_distance[at.w]);
            let now_sides = vec2<f32>(liquid_distance[row + before], liquid_distance[row + after]);
            highest = max(highest, max(now, max(vec4<f32>(now_sides.x, now.xyz), vec4<f32>(now.yzw, now_sides.y))));
        }
    }
    // With a margin for the rounding of means.
    return (lowest < vec4<f32>(MARGIN - MARKER_DEPTH)) & (step.inv_dx * highest >= vec4<f32>(-MARKER_DEPTH - MARGIN));
}

// The cell centres around a site of a quad; bit: see seeds.
fn place_of(first: vec3<i32>, bit: u32) -> Corner {
    let cell = vec3<u32>(first) + vec3<u32>(bit / SITES, 0u, 0u);
    return centres_around(site(cell, hash_of_cell(cell), bit % SITES));
}

// The sites of a quad that enter.
fn entering(quad: u32) -> u32 {
    let first = quad_cell(level, quad);
    let inside = lanes_inside(first, vec3<i32>(level.cells));
    var near = 0u;
    for (var l = 0u; l < 4u; l++) {
        let now = step.inv_dx * liquid_distance[4u * quad + l];
        near |= u32(now >= LOWEST && min(carried_level[4u * quad + l], now) <= HIGHEST) << l;
    }
    near &= lane_bits(inside);
    if near == 0u {
        return 0u;
    }
    near &= lane_bits(may_enter(first));
    // Four bits to four runs of eight.
    var candidates = (near & 1u | (near & 2u) << 7u | (near & 4u) << 14u | (near & 8u) << 21u) * 0xffu;
    var below = 0u;
    while candidates != 0u {
        let bit = firstTrailingBit(candidates);
        candidates &= candidates - 1u;
        below |= u32(carried_at(place_of(first, bit)) < -MARKER_DEPTH) << bit;
    }
    var sites = 0u;
    while below != 0u {
        let bit = firstTrailingBit(below);
        below &= below - 1u;
        let place = place_of(first, bit);
        sites |= u32(level_at(place) >= -MARKER_DEPTH && is_free(place)) << bit;
    }
    return sites;
}

@compute @workgroup_size(WG_SIZE)
fn count_seeds(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var sites = 0u;
    if index < band_args[3] {
        sites = entering(band_list[index]);
        seeds[index] = sites;
    }
    atomicAdd(&sh_seeds, countOneBits(sites));
    workgroupBarrier();
    if lane == 0u && index < band_args[3] {
        chunks[group_index(workgroup)] = atomicLoad(&sh_seeds);
    }
}
