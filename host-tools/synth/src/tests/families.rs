//! Every family of every stage, in an episode that slips.

use super::*;

/// One recipe for each family of each stage, named.
fn recipes() -> impl Iterator<Item = (String, Recipe)> {
    let laboratory = Recipe {
        scenario: ScenarioChoice::SixStep,
        object: ObjectChoice::Named("usb-cable".to_owned()),
        seconds: Some(6.0),
        speed_mm_s: Some(10.0),
        ..Recipe::new(11)
    };
    let places = Stage::ALL.into_iter().flat_map(|stage| (0..FAMILIES).map(move |place| (stage, place)));
    places.map(move |(stage, place)| {
        let recipe = laboratory.clone().with_family(stage, place);
        (recipe.family(stage), recipe)
    })
}

#[test]
fn every_family_grips_slips_and_sounds() {
    let mut first = None;
    for (name, recipe) in recipes() {
        let episode = generate(&recipe).unwrap();
        episode.validate().unwrap();
        let again = generate(&recipe).unwrap();
        assert!(episode == again, "{name}");
        let (no_slip, slip) = (count(&episode, labels::NO_SLIP), count(&episode, labels::SLIP));
        let levels = levels::rms_mg(&episode, 34);
        let of = |class| median(levels::of_label(&episode, &levels, class));
        let (held_mg, slip_mg) = (of(labels::NO_SLIP), of(labels::SLIP));
        let area = |class: u8| {
            let label = episode.label.as_ref().unwrap();
            let areas = (0..episode.frames())
                .filter(|&f| label[f] == class)
                .map(|f| episode.piezo(f, 0).counts().iter().filter(|&&count| count > 3).count() as f64);
            median(areas.collect())
        };
        let moved = f64::from(episode.slip_true_mm_s.as_ref().unwrap().iter().copied().fold(0.0, f32::max));
        println!(
            "{name}: {no_slip} frames held, {slip} of slip at up to {moved:.1} mm/s; {held_mg:.1} mg held, \
             {slip_mg:.1} slipping; {} taxels touched (synthetic)",
            area(labels::SLIP)
        );
        assert!(no_slip > 60 && slip > 60, "{name}");
        assert!((5.0..200.0).contains(&moved), "{name}");
        assert!((1.0..500.0).contains(&held_mg) && (3.0..1_000.0).contains(&slip_mg), "{name}");
        assert!((6.0..700.0).contains(&area(labels::SLIP)), "{name}");
        // The laboratory's family of every stage is the same episode; every other is another one.
        let laboratory = recipe.families.is_laboratory() && recipe.vibration == SourceFamily::Asperities;
        let first = first.get_or_insert_with(|| episode.clone());
        assert_eq!(laboratory, *first == episode, "{name}");
    }
}
