// spray, last: moves the volume of markers that took off or landed between the spray and the targets of the components.
// One thread per quad of the band.
// band_args, band_list: the band. component_flights: markers that landed less those that took off, at the label of the
// component beside them; zero afterwards. component_volume: targets, volumes of a cell; in place.
#import dispatch
#import spray_sums

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read_write> component_flights: array<vec4<i32>>;
@group(0) @binding(3) var<storage, read_write> component_volume: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn settle_flights(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let landed = component_flights[quad];
    if any(landed != vec4<i32>()) {
        component_volume[quad] += MARKER_VOLUME * vec4<f32>(landed);
        component_flights[quad] = vec4<i32>();
    }
}
