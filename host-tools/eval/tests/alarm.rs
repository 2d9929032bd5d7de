//! `network-alarm` against the rule counted by hand from the scores of `network`.

use slipsense::fixed::Logit;
use slipsense::net::format::{Dims, OperatingPoint};
use slipsense_eval::detectors::{NEVER, Setup, Verdict, by_name};
use slipsense_eval::fit::Fitted;
use slipsense_recording::Episode;
use slipsense_recording::model_file::random_model;
use slipsense_synth::{Recipe, ScenarioChoice, generate};

fn judged(name: &str, model: &[u8], episodes: &[&Episode]) -> Vec<Verdict> {
    let fitted = Fitted::bundled().unwrap();
    let setup = Setup { fitted: &fitted, model, float_weights: None, dead: None };
    let mut detector = by_name(name, &setup).unwrap();
    episodes.iter().map(|episode| detector.judge(episode).unwrap()).collect()
}

fn model(point: OperatingPoint) -> Vec<u8> {
    let dims = Dims { conv_channels: [2, 2, 2], embed: 4, xl_kernel: 2, xl_channels: 4, heads: 2, window: 8 };
    let mut file = random_model(dims, 3);
    file.point = point;
    file.to_bytes().unwrap()
}

#[test]
fn k_of_n_over_the_threshold_across_episodes() {
    let episode = |seed| {
        let (scenario, seconds) = (ScenarioChoice::SixStep, Some(3.0));
        generate(&Recipe { scenario, seconds, ..Recipe::new(seed) }).unwrap()
    };
    let episodes = [episode(3), episode(4)];
    let episodes: Vec<&Episode> = episodes.iter().collect();
    let by_class = judged("network", &model(OperatingPoint::ARGMAX), &episodes);
    let margins: Vec<f32> = by_class.iter().flat_map(|verdict| verdict.score.clone()).collect();
    // A threshold in the middle of what this network of random weights says.
    let mut sorted: Vec<f32> = margins.iter().copied().filter(|&margin| margin != NEVER).collect();
    sorted.sort_by(f32::total_cmp);
    let threshold_q10 = (sorted[sorted.len() / 2] * 1024.0) as i32;
    let point = |k, n| OperatingPoint { threshold: Logit::from_bits(threshold_q10), k, n };
    for (k, n) in [(1, 1), (2, 3), (5, 8), (20, 32)] {
        let by_alarm = judged("network-alarm", &model(point(k, n)), &episodes);
        let classes: Vec<u8> = by_alarm.iter().flat_map(|verdict| verdict.class.clone()).collect();
        let mut slips = 0;
        for frame in 0..margins.len() {
            let recent = &margins[(frame + 1).saturating_sub(n.into())..=frame];
            let over = recent.iter().filter(|&&margin| margin * 1024.0 > threshold_q10 as f32).count();
            assert_eq!(classes[frame] == 2, over >= usize::from(k), "{k} of {n}, frame {frame}");
            slips += usize::from(classes[frame] == 2);
        }
        println!("{k} of {n}: slip in {slips} of {} frames", margins.len());
        assert!(slips > 0 && slips < margins.len());
        for verdict in by_alarm {
            let by_rule = Verdict::new(verdict.score.clone(), verdict.threshold, verdict.fallback.clone());
            assert_eq!(by_rule.class, verdict.class);
        }
    }
    let argmax = judged("network-alarm", &model(OperatingPoint::ARGMAX), &episodes);
    let same = argmax.iter().zip(&by_class).all(|(a, b)| (&a.class, &a.score) == (&b.class, &b.score));
    assert!(same, "at the point of the classes both are one");
}
