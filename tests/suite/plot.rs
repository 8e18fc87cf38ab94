//! `plot`: charts of what tables hold, several runs over one another, refusals that name the folder.

use std::fs;
use std::path::Path;

use cutwater::output::plot::{plot, plot_probes, with_sweeps};
use cutwater::output::report::{Contents, report};

use crate::common::assert_has;

fn run(dir: &Path, factor: f64) {
    fs::create_dir_all(dir).unwrap();
    let mut steps = "step,t,dt,iterations,residual_p,status,kinetic_energy,seconds_total\n".to_owned();
    let mut probes = "step,t,front,centre_x,centre_y,centre_z,gauge\n".to_owned();
    for step in 0..20 {
        let t = 0.1 * f64::from(step + 1);
        // A residual of 0 has no place on a logarithmic axis, and a probe may be empty.
        let residual = if step == 3 { 0.0 } else { 1e-9 * t };
        steps += &format!("{step},{t},0.1,12,{residual:e},converged,{},0.02\n", factor * t);
        let gauge = if step < 5 { String::new() } else { format!("{t}") };
        probes += &format!("{step},{t},{},{t},1,NaN,{gauge}\n", factor * t * t);
    }
    fs::write(dir.join("steps.csv"), steps).unwrap();
    fs::write(dir.join("probes.csv"), probes).unwrap();
}

#[test]
fn charts_of_all_that_tables_hold() {
    let folder = tempfile::tempdir().unwrap();
    let [a, b] = ["first", "second"].map(|name| folder.path().join(name));
    run(&a, 1.0);
    run(&b, 2.0);
    let files = plot(std::slice::from_ref(&a), &a.join("plots")).unwrap();
    let names: Vec<_> = files.iter().map(|file| file.file_name().unwrap()).collect();
    assert_eq!(names, ["steps.svg", "probes.svg"]);
    let [steps, probes] = [0, 1].map(|at| fs::read_to_string(&files[at]).unwrap());
    for part in ["iterations", "true relative residuals", "energies of the liquid, J"] {
        assert!(steps.contains(part), "{part}");
    }
    // What the run does not have has no chart.
    assert!(!steps.contains("det F") && !steps.contains("energies of the solids"));
    for part in ["front", "centre_x", "centre_y", "gauge"] {
        assert!(probes.contains(part), "{part}");
    }
    for page in [&steps, &probes] {
        assert!(page.starts_with("<svg") && !page.contains("NaN"), "{page}");
        assert!(!page.contains("first"), "one run needs no name");
    }
    let expected = Contents { folders: 2, tables: 2, pictures: 2 };
    assert_eq!(report(&a).unwrap(), expected, "the drawings are whole");
    // A line for each of dt, iterations, residuals (without the 0), energy and seconds; axes have fewer points.
    assert_eq!(lines(&steps), [20, 20, 19, 20, 20]);
    let files = plot(&[a.clone(), b.clone()], &folder.path().join("both")).unwrap();
    let both = fs::read_to_string(&files[0]).unwrap();
    assert!(both.contains("first: kinetic_energy") && both.contains("second: kinetic_energy"));
}

/// Points of the lines that have many.
fn lines(page: &str) -> Vec<usize> {
    let lines = page.split("points=\"").skip(1);
    let points = lines.map(|rest| rest.split('"').next().unwrap().split_whitespace().count());
    points.filter(|points| *points > 10).collect()
}

#[test]
fn what_is_no_run_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("plots");
    let error = plot(&[folder.path().to_owned()], &out).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("it holds no run"), "{error}");
    let broken = folder.path().join("broken");
    for (text, told) in [
        ("step,t\n0,0.1\n1\n", "cannot be read"),
        ("step,time\n0,0.1\n", "no time t"),
        ("step,t\n0,soon\n", "no time t"),
        ("", "it is empty"),
    ] {
        fs::create_dir_all(&broken).unwrap();
        fs::write(broken.join("steps.csv"), text).unwrap();
        let error = plot(std::slice::from_ref(&broken), &out).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let message = error.to_string();
        assert_has(&message, &["steps.csv", told]);
    }
    assert!(!out.exists(), "nothing is written for what cannot be plotted");
}

#[test]
fn sweeps_stand_for_their_finished_runs_and_probes_can_be_chosen() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = folder.path().join("sweep");
    for name in ["a", "b", "c"] {
        run(&sweep.join(name), 1.0);
    }
    fs::write(
        sweep.join("summary.csv"),
        "cfl,status,folder,problem\n1,finished,a,\n2,failed,b,\"x, y\"\n3,finished,c,\n",
    )
    .unwrap();
    let single = folder.path().join("single");
    run(&single, 1.0);
    let runs = with_sweeps(&[single.clone(), sweep.clone()]).unwrap();
    assert_eq!(runs, [single, sweep.join("a"), sweep.join("c")]);
    let chosen = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
        plot_probes(&runs, &names, &folder.path().join("plots"))
    };
    let page = fs::read_to_string(chosen(&["centre", "gauge"]).unwrap()).unwrap();
    for part in ["a: centre_x", "c: centre_y", "single: gauge"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("front"));
    let page = fs::read_to_string(chosen(&["centre_y"]).unwrap()).unwrap();
    assert!(page.contains("centre_y") && !page.contains("centre_x"));
    let error = chosen(&["tip"]).unwrap_err().to_string();
    for part in ["--probes", "no run has a probe \"tip\"", "front, centre_x"] {
        assert!(error.contains(part), "{error}");
    }
    for (summary, problem) in
        [("status,folder\nfailed,a\n", "no finished run"), ("folder\na\n", "no columns `status` and `folder`")]
    {
        fs::write(sweep.join("summary.csv"), summary).unwrap();
        let error = with_sweeps(std::slice::from_ref(&sweep)).unwrap_err().to_string();
        assert!(error.contains(problem), "{error}");
    }
}
