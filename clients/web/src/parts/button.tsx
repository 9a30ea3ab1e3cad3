import type { ComponentChildren } from "preact";

interface Props {
  children: ComponentChildren;
  /** Whether it does nothing now. It can still be reached, so that the keyboard keeps its place. */
  off?: boolean;
  /** None for one that sends the form around it. */
  press?: () => void;
  look?: string;
  label?: string;
  title?: string;
  pressed?: boolean;
  focus?: (element: HTMLButtonElement | null) => void;
}

export function Button({ children, off = false, press, look = "", label, title, pressed, focus }: Props) {
  return (
    <button
      ref={focus ?? null}
      type={press ? "button" : "submit"}
      class={look}
      aria-disabled={off}
      aria-label={label}
      aria-pressed={pressed}
      title={title}
      onClick={(event) => {
        if (off) event.preventDefault();
        else press?.();
      }}
    >
      {children}
    </button>
  );
}
