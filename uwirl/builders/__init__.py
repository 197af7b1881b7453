"""Objects from settings, by what they are for; `uwirl.build` is their face."""
