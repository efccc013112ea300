// A recorded run, alone on its page.

connectPlayer();
showScene(scenes[0]);
