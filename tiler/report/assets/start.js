// Build the page. What goes wrong here is told on the page, not only in the console.

try {
  document.body.append(...(data.kind === "study" ? studyPage() : framesPage()));
} catch (error) {
  document.body.append(h("p", { class: "bad", role: "alert" }, `This report cannot be shown: ${error.message}`));
  throw error;
}
