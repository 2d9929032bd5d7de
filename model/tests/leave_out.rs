//! A comparison of trainings without one family of physics: every network runs once, and all stand in one table.

use std::fs;

use slipsense_model::{LeaveOutArgs, run_leave_out};

use crate::common;

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn every_family_of_a_stage_is_left_out_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let few = "--stages friction --seeds 1 --episodes 12 --steps 2 --test-episodes 1 --jobs 2";
    let args: LeaveOutArgs = common::args(&format!("--out {} {few}", out.display()));
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    run_leave_out(&args).unwrap();
    let results = common::json(&out.join("leave-out.json"));
    let tested = results["tested"].as_array().unwrap();
    let families: Vec<_> = tested.iter().map(|tested| tested["family"].as_str().unwrap()).collect();
    assert_eq!(families, ["brush", "bristle", "mass", "rate_state"]);
    assert_eq!([0, 3].map(|at| tested[at]["is_held_out"].as_bool().unwrap()), [false, true]);
    for tested in tested {
        let all = tested["all_macro_f1"]["mean"].as_f64().unwrap();
        assert_eq!(tested["without"].as_array().unwrap().len(), 3);
        for cost in tested["without"].as_array().unwrap() {
            let difference = 100.0 * (cost["macro_f1"]["mean"].as_f64().unwrap() - all);
            assert!((difference - cost["difference"]["points"].as_f64().unwrap()).abs() < 1e-9, "{cost}");
        }
    }
    assert!(results["episodes"].as_u64().unwrap() < 12, "each is trained without one family");
    assert!(read("report.txt").contains("without bristle") && read("leave-out.svg").contains("rate_state *"));

    // What is finished stays; another budget is refused.
    let kept = read("without-friction-mass-1.json");
    fs::remove_file(out.join("all-1.json")).unwrap();
    run_leave_out(&args).unwrap();
    assert_eq!(common::json(&out.join("leave-out.json")), results);
    assert_eq!(read("without-friction-mass-1.json"), kept);
    let error = run_leave_out(&LeaveOutArgs { steps: 3, ..args }).unwrap_err();
    assert!(format!("{error:#}").contains("budget.json: budget is"), "{error:#}");
}
