#import component_sums
#import components

// A cavity of a solid and the liquid in it: stages::Cavity is the same struct on the host.
struct Cavity {
    // smallest root of the sealed components that touch it; NONE for none
    root: u32,
    // open volume of that component: low and high words, see component_sums
    low: u32,
    high: u32,
    // source, volumes of a cell per second
    source: f32,
    // least and largest open volume that fill the cavity, cells
    least: f32,
    largest: f32,
}

// Open volume of the component, cells.
fn open_cells(cavity: Cavity) -> f32 {
    return value_of(vec2<u32>(cavity.low, cavity.high));
}

fn is_filled(cavity: Cavity) -> bool {
    let open = open_cells(cavity);
    return cavity.root != NONE && open >= cavity.least && open <= cavity.largest;
}
