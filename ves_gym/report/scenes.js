// Which of the simulated queries is shown moving.

if (choices("scene", $("scene-pick"), scenes.map(caseLabel), "animation")) {
  connectPlayer();
  showScene(scenes[0]);
  $("scene-pick").addEventListener("change", (event) => showScene(scenes[event.target.value]));
}
