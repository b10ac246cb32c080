{{- define "trueup.name" -}}
{{- if contains "trueup" .Release.Name }}{{ .Release.Name }}{{ else }}{{ .Release.Name }}-trueup{{ end -}}
{{- end -}}

{{- define "trueup.labels" -}}
app.kubernetes.io/name: trueup
app.kubernetes.io/instance: {{ .Release.Name }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ .Chart.Name }}-{{ .Chart.Version }}
{{- end -}}

{{- /* The labels that select the pods of a part: a list of the root and the part's name. */ -}}
{{- define "trueup.selector" -}}
app.kubernetes.io/name: trueup
app.kubernetes.io/instance: {{ (index . 0).Release.Name }}
app.kubernetes.io/component: {{ index . 1 }}
{{- end -}}

{{- define "trueup.image" -}}
{{- $root := index . 0 -}}
{{ $root.Values.image.registry }}trueup-{{ index . 1 }}:{{ $root.Values.image.tag | default $root.Chart.AppVersion }}
{{- end -}}

{{- /* The settings, with the names under which the service is asked. */ -}}
{{- define "trueup.settings" -}}
{{- $name := include "trueup.name" . -}}
{{- $hosts := list $name (printf "%s.%s" $name .Release.Namespace) "*.svc.cluster.local" -}}
{{- if .Values.ingress.enabled -}}{{- $hosts = append $hosts .Values.ingress.host -}}{{- end -}}
{{- with .Values.settings.TRUEUP_ALLOWED_HOSTS -}}{{- $hosts = append $hosts . -}}{{- end -}}
{{- $settings := set (deepCopy .Values.settings) "TRUEUP_ALLOWED_HOSTS" (join "," $hosts) -}}
{{- if and .Values.ingress.enabled (not .Values.settings.TRUEUP_PUBLIC_URL) -}}
{{- $scheme := ternary "https" "http" (ne .Values.ingress.tlsSecret "") -}}
{{- $settings = set $settings "TRUEUP_PUBLIC_URL" (printf "%s://%s" $scheme .Values.ingress.host) -}}
{{- end -}}
{{- range $key, $value := $settings }}
{{- /* a values file's whole numbers are floats here, and would be written as 2e+09 */ -}}
{{- if and (kindIs "float64" $value) (eq (floor $value) $value) }}{{ $value = printf "%.0f" $value }}{{ end }}
{{ $key }}: {{ $value | toString | quote }}
{{- end }}
{{- end -}}

{{- define "trueup.podSecurity" -}}
runAsNonRoot: true
runAsUser: 10001
fsGroup: 10001
seccompProfile: {type: RuntimeDefault}
{{- end -}}

{{- define "trueup.containerSecurity" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: {drop: [ALL]}
{{- end -}}

{{- define "trueup.mounts" -}}
- {name: data, mountPath: /var/lib/trueup/data}
- {name: tmp, mountPath: /tmp}
{{- end -}}

{{- /* Where pods of a part run: spread over the nodes, and as the values of the part say. */ -}}
{{- define "trueup.scheduling" -}}
{{- $root := index . 0 -}}{{- $values := index $root.Values (index . 1) -}}
topologySpreadConstraints:
  - maxSkew: 1
    topologyKey: kubernetes.io/hostname
    whenUnsatisfiable: ScheduleAnyway
    labelSelector:
      matchLabels: {{- include "trueup.selector" . | nindent 8 }}
{{- with $values.nodeSelector }}
nodeSelector: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with $values.tolerations }}
tolerations: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with $root.Values.image.pullSecrets }}
imagePullSecrets: {{- range . }}
  - name: {{ . }}
{{- end }}
{{- end }}
{{- end -}}

{{- /* Where pods may connect to: names, the database, the store, and what else the values say. */ -}}
{{- define "trueup.out" -}}
- to: [{namespaceSelector: {}}]
  ports: [{protocol: UDP, port: 53}, {protocol: TCP, port: 53}]
{{- range concat (list .database .store) .out }}
- to: [{ipBlock: {cidr: {{ .cidr }}}}]
  ports: [{protocol: TCP, port: {{ .port }}}]
{{- end }}
{{- end -}}
